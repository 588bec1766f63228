# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Draw the pictures of doc/effects.md: one small experiment for each effect."""

from pathlib import Path

from closedloop_dynamics import Simulation
from closedloop_dynamics.effects.actuator import Actuator
from closedloop_dynamics.effects.body_contact import BodyContact
from closedloop_dynamics.effects.bushing import Bushing
from closedloop_dynamics.effects.cable import Cable
from closedloop_dynamics.effects.contact import Contact
from closedloop_dynamics.effects.end_stop import EndStop
from closedloop_dynamics.effects.external_force import ExternalForce
from closedloop_dynamics.effects.fluid_drag import FluidDrag
from closedloop_dynamics.effects.force_table import ForceTable
from closedloop_dynamics.effects.gravity import Gravity
from closedloop_dynamics.effects.joint_damping import JointDamping
from closedloop_dynamics.effects.joint_friction import JointFriction
from closedloop_dynamics.effects.joint_spring import JointSpring
from closedloop_dynamics.effects.payload import Payload
from closedloop_dynamics.effects.point_spring import PointSpring
from closedloop_dynamics.effects.prescribed_force import PrescribedForce
from closedloop_dynamics.effects.rotor import Rotor
from closedloop_dynamics.effects.sensor import Sensor
from closedloop_dynamics.effects.tendon import Tendon
from closedloop_dynamics.mechanism.mechanism import Body, Joint, Mechanism, Point
from closedloop_dynamics.scene.records import Initial, Method, Scene
import matplotlib.figure
import numpy as np

DIRECTORY = Path(__file__).parent / 'pictures'
COLORS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7')
EARTH = Gravity((0.0, -9.81))
BLOCK = Mechanism(
    'block', (Body('block', 1.0, (0.0, 0.0), 0.1),),
    (Joint('slide', 'prismatic', 'ground', 'block', (0.0, 0.0), 0.0, True),), (),
    (Point('center', 'block', (0.0, 0.0)),))
UPRIGHT = Mechanism(
    'upright', (Body('block', 1.0, (0.0, 0.0), 0.1),),
    (Joint('slide', 'prismatic', 'ground', 'block', (0.0, 0.0), np.pi / 2.0, True),), (),
    (Point('center', 'block', (0.0, 0.0)), Point('floor', 'ground', (0.0, 0.0)),
     Point('ceiling', 'ground', (0.0, 0.5))))
PENDULUM = Mechanism(
    'pendulum', (Body('rod', 1.0, (0.25, 0.0), 0.02),),
    (Joint('hinge', 'revolute', 'ground', 'rod', (0.0, 0.0), 0.0, True),), (),
    (Point('tip', 'rod', (0.5, 0.0)),))


def run(mechanism, effects, start, rate=0.0, duration=2.0, torque=None, of=None):
    """Return times, and a quantity (the position by default) of a run."""
    simulation = Simulation(Scene('picture', None, '', mechanism, Initial((start,), (rate,)),
                                  effects, Method(step_size=5e-4)))
    of = of or (lambda simulation: simulation.position[0])
    times = np.linspace(0.0, duration, 401)
    values = [of(simulation)]
    for _ in times[1:]:
        command = torque(simulation.time) if callable(torque) else torque
        simulation.step(None if command is None else [command], duration / 400)
        values.append(of(simulation))
    return times, np.array(values)


def draw(name, ylabel, curves, xlabel='time [s]', styles=()):
    """Write one picture; ``curves`` maps a label to its x and y, ``styles`` to how it is drawn."""
    figure = matplotlib.figure.Figure((5.6, 2.6), layout='constrained')
    axes = figure.subplots()
    for k, (label, (x, y)) in enumerate(curves.items()):
        axes.plot(x, y, label=label, **{
            'color': COLORS[k % 4], 'linewidth': 1.4, **dict(styles).get(label, {})})
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    axes.grid(alpha=0.3)
    axes.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)
    figure.savefig(DIRECTORY / f'effect_{name}.png', dpi=110)


def masses():
    """Draw gravity, payload and rotor: what changes the mechanism itself."""
    swing = [-0.5 * np.pi + 1.0, 0.0, 3.0]
    draw('gravity', 'angle [rad]', {
        f'{label}': run(PENDULUM, {'gravity': Gravity((0.0, -g))}, *swing)
        for label, g in (('earth', 9.81), ('moon', 1.62))})
    draw('payload', 'angle [rad]', {
        'bare': run(PENDULUM, {'gravity': EARTH}, *swing),
        '1 kg at the tip': run(PENDULUM, {
            'gravity': EARTH, 'part': Payload('rod', 1.0, (0.5, 0.0))}, *swing)})
    draw('rotor', 'angle [rad]', {
        'bare': run(PENDULUM, {'gravity': EARTH}, *swing),
        '1e-4 kg m², gear 50': run(PENDULUM, {
            'gravity': EARTH, 'motor': Rotor('hinge', 1e-4, 50.0)}, *swing)})


def joints():
    """Draw damping, springs, stops and friction of joints."""
    spring = JointSpring('slide', 100.0)
    draw('joint_spring', 'position [m]', {
        f'{k:g} N/m': run(BLOCK, {'spring': JointSpring('slide', k)}, 0.1) for k in (25.0, 100.0)})
    draw('joint_damping', 'position [m]', {
        f'{c:g} N s/m': run(BLOCK, {'spring': spring, 'oil': JointDamping('slide', c)}, 0.1)
        for c in (0.5, 2.0, 20.0)})
    draw('end_stop', 'height [m]', {
        f'c = {c:g} s/m': run(UPRIGHT, {
            'gravity': EARTH, 'floor': EndStop('slide', 1e4, lower=0.0, damping=c)}, 0.3)
        for c in (0.0, 0.2, 1.0)})
    draw('joint_friction', 'position [m]', {
        'Coulomb 1 N': run(BLOCK, {
            'spring': spring, 'friction': JointFriction('slide', 1.0)}, 0.105),
        '2 N at rest': run(BLOCK, {
            'spring': spring, 'friction': JointFriction(
                'slide', 1.0, static_ratio=2.0, stribeck_velocity=0.1)}, 0.105)})


def points():
    """Draw springs, forces and contact at points."""
    swing = [-0.5 * np.pi + 1.0, 0.0, 3.0]
    draw('point_spring', 'angle [rad]', {
        'gravity alone': run(PENDULUM, {'gravity': EARTH}, *swing),
        'spring and damper': run(PENDULUM, {'gravity': EARTH, 'strut': PointSpring(
            'tip', anchor=(0.5, -0.5), stiffness=5.0, damping=2.0, free_length=0.4)}, *swing)})
    draw('external_force', 'angle [rad]', {
        f'{f:g} N to the right': run(
            PENDULUM, {'gravity': EARTH, 'push': ExternalForce('tip', (f, 0.0)),
                       'oil': JointDamping('hinge', 0.1)}, -0.5 * np.pi, 0.0, 3.0)
        for f in (0.0, 2.0, 5.0)})

    def normal(simulation):
        return simulation.effect_readings('ground')['normal_force']

    def depth(simulation):
        return 1e3 * simulation.effect_readings('ground')['depth']

    curves = {}
    for c in (0.0, 1.0, 4.0):
        effects = {'ground': Contact('center', (0.0, 0.0), 2e5, exponent=1.5, damping=c)}
        curves[f'c = {c:g} s/m'] = tuple(
            run(UPRIGHT, effects, 0.0005, -0.5, 0.06, of=of)[1] for of in (depth, normal))
    draw('contact', 'normal force [N]', curves, 'depth [mm]')


def elements():
    """Draw what machines are made of: forces over time, tables, bushings, cables, contact."""
    def force(simulation):
        return simulation.effect_readings('force')['force']

    pulse = {'amplitude': 2.0, 'start': 0.1, 'rise': 0.3, 'hold': 0.2}
    draw('prescribed_force', 'force [N]', {
        label: run(BLOCK, {'force': PrescribedForce(shape, 'slide', **keys)}, 0.0, 0.0, 1.0,
                   of=force)
        for label, shape, keys in (
            ('sine', 'sine', {'amplitude': 1.0, 'frequency': 2.0}),
            ('trapezoid', 'trapezoid', pulse), ('cycloid', 'cycloid', pulse),
            ('table, cubic', 'table', {
                'times': (0.0, 0.2, 0.4, 0.7, 1.0), 'interpolation': 'cubic',
                'values': (0.0, -1.0, 0.5, -0.5, 0.0)}))})
    strokes = np.linspace(-0.15, 0.15, 31)
    bistable = ForceTable(tuple(strokes), tuple(200.0 * strokes * (1.0 - (strokes / 0.1) ** 2)),
                          'slide', interpolation='cubic', damping=1.0)
    draw('force_table', 'position [m]', {
        f'bistable, from {x:g} m': run(BLOCK, {'spring': bistable}, x, v)
        for x, v in ((0.01, 0.0), (-0.01, 0.0), (0.15, 0.0))})
    draw('bushing', 'angle [rad]', {
        f'{c:g} N m s/rad': run(PENDULUM, {'gravity': EARTH, 'mount': Bushing(
            'tip', anchor=(0.5, 0.0), turning_stiffness=30.0, turning_damping=c)},
            -0.5, 0.0, 2.0) for c in (0.0, 0.3)})
    draw('tendon', 'position [m]', {
        label: run(BLOCK, {'spring': Tendon({'slide': 1.0}, stiffness, rest=rest)}, 0.1)
        for label, stiffness, rest in (
            ('linear', 100.0, 0.0), ('with play of 0.05 m', 100.0, (-0.05, 0.0)),
            ('cubic', (0.0, 0.0, 1e4), 0.0))})
    draw('fluid_drag', 'speed [m/s]', {
        label: run(UPRIGHT, {'gravity': EARTH, 'air': FluidDrag(
            'center', linear=(linear, 0.0), quadratic=(quadratic, 0.0))}, 0.0,
            of=lambda simulation: simulation.velocity[0])
        for label, linear, quadratic in (
            ('linear', 2.0, 0.0), ('quadratic', 0.0, 0.4), ('both', 2.0, 0.4))})
    draw('cable', 'height [m]', {
        f'c = {c:g} s/m': run(UPRIGHT, {'gravity': EARTH, 'rope': Cable(
            ('ceiling', 'center'), 2e3, 0.5, damping=c)}, 0.3, 0.0, 1.5) for c in (0.0, 0.2)})
    draw('body_contact', 'height [m]', {
        f'e = {e:g}': run(UPRIGHT, {'gravity': EARTH, 'floor': BodyContact(
            'center', 'floor', 'line', 1e5, restitution=e, impact_velocity=2.4)}, 0.3, 0.0, 1.5)
        for e in (1.0, 0.8, 0.5)})


def machines():
    """Draw the shipped machines that are made of elements."""
    figure = matplotlib.figure.Figure((9.0, 5.2), layout='constrained')
    for axes, (name, duration, joint, factor, label) in zip(figure.subplots(2, 2).flat, (
            ('cam_follower', 0.5, 1, 1e3, "roller's height [mm]"),
            ('rope_hoist', 0.5, None, 1e3, 'height [mm]'),
            ('bistable_toggle', 2.0, 0, 1.0, 'angle of the lever [rad]'),
            ('geneva_drive', 0.5, 1, 1.0, 'angle of the wheel [rad]'))):
        simulation = Simulation.from_scene(name)
        times, positions = [0.0], [simulation.position]
        for _ in range(250):
            simulation.step(duration=duration / 250)
            times.append(simulation.time)
            positions.append(simulation.position)
        positions = factor * np.array(positions)
        joints = range(positions.shape[1]) if joint is None else [joint]
        for k, color in zip(joints, COLORS):
            axes.plot(times, positions[:, k], color=color, linewidth=1.4,
                      label=simulation.joint_names[k].removesuffix('_joint'))
        if joint is None:
            axes.legend(frameon=False, fontsize=8)
        axes.set(title=name, xlabel='time [s]', ylabel=label)
        axes.grid(alpha=0.3)
    figure.savefig(DIRECTORY / 'machine_elements.png', dpi=110)


def gears():
    """Draw the shipped machines with gears, belts, rods and slots."""
    figure = matplotlib.figure.Figure((9.0, 5.2), layout='constrained')
    rate = 'rate [rad/s]'
    panels = (
        ('planetary_gear', 1.0, rate, lambda one: one.velocity[:3], ('sun', 'ring', 'carrier')),
        ('planetary_gear', 1.0, 'forces of teeth [N]', lambda one: one.tooth_forces[[0, 3]],
         ('sun, each planet', 'ring')),
        ('rack_press', 1.0, 'way of the ram [mm]', lambda one: 1e3 * one.position[1:], ()),
        ('differential', 1.0, rate, lambda one: one.velocity[[3, 4, 1]],
         ('left', 'right', 'carrier')),
        ('scissor_lift', 2.0, 'height [m]', lambda one: one.point('load')[1:], ()),
        ('geared_five_bar', 2.0, 'belt force [N]', lambda one: one.tooth_forces, ()))
    for axes, (name, duration, label, take, names) in zip(figure.subplots(2, 3).flat, panels):
        simulation = Simulation.from_scene(name)
        times, values = [0.0], [take(simulation)]
        for _ in range(250):
            simulation.step(duration=duration / 250)
            times.append(simulation.time)
            values.append(take(simulation))
        for line, color in zip(np.transpose(values), COLORS):
            axes.plot(times, line, color=color, linewidth=1.4)
        if names:
            axes.legend(names, frameon=False, fontsize=8)
        axes.set(title=name, xlabel='time [s]', ylabel=label)
        axes.grid(alpha=0.3)
    figure.savefig(DIRECTORY / 'machine_gears.png', dpi=110)


def drives_and_sensors():
    """Draw what becomes of commands and of what is measured."""
    def effort(simulation):
        return simulation.effort[0]

    def command(time):
        return 8.0 if time < 0.3 else -3.0

    times = np.linspace(0.0, 0.6, 401)
    draw('actuator', 'force [N]', {
        'command': (times, np.array([command(time) for time in times])),
        **{label: run(BLOCK, {'motor': motor}, 0.0, 0.0, 0.6, command, effort)
           for label, motor in (
               ('limit 5 N', Actuator('slide', max_torque=5.0)),
               ('lag 50 ms', Actuator('slide', lag=0.05)),
               ('delay 50 ms', Actuator('slide', delay=0.05)))}}, styles={
        'command': {'color': 'black', 'linewidth': 2.6, 'alpha': 0.35},
        'delay 50 ms': {'color': COLORS[0]}})
    spring = JointSpring('slide', 100.0)

    def measured(simulation):
        return simulation.measured()[0][0]

    draw('sensor', 'position [m]', {
        **{label: run(BLOCK, {'spring': spring, 'encoder': sensor}, 0.1, 0.0, 0.8, None, measured)
           for label, sensor in (
               ('noise 5 mm', Sensor(position_noise=0.005)),
               ('steps of 20 mm', Sensor(position_resolution=0.02)),
               ('50 ms late', Sensor(delay=0.05)))},
        'true': run(BLOCK, {'spring': spring}, 0.1, 0.0, 0.8)}, styles={
            'noise 5 mm': {'linestyle': '', 'marker': '.', 'markersize': 2.5},
            'true': {'color': 'black', 'linewidth': 0.8}})


if __name__ == '__main__':
    DIRECTORY.mkdir(exist_ok=True)
    masses()
    joints()
    points()
    elements()
    machines()
    gears()
    drives_and_sensors()
