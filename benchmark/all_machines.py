# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What accuracy costs on every shipped scene, and on ten robots that others have published.

Each machine moves freely from its start, and under torques that swing and are held at 100 Hz and
at 1 kHz. The default method is asked for an accuracy of 1e-3, 1e-6 and 1e-9; beside it stand
Pinocchio (constraintDynamics and lcaba, RK4 and Runge-Kutta-Fehlberg 7(8) in C++) and MuJoCo (RK4
and implicitfast, its loops as stiff as the step allows), wherever they know the machine: the
cheapest of their settings that keeps the error. They know joints, loops and gravity, but none of
the other effects of a scene: where these matter, they do not come near its motion.

The motion that errors are measured against is that of dop853 with a tolerance of 1e-13; dopri5
with another formulation shows how far and how well it is known. CPU time of one thread; of held
torques that of a loop in Python that makes a call for each of them. Robots are found by name in a
folder with a clone of example-parallel-robots and left out without it.
"""

import argparse
import csv
from dataclasses import replace
import json
import math
import os
from pathlib import Path
import sys
import time
import warnings

# Before anything loads a library that has threads of its own.
for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ[_name] = '1'

from machine import commit, description, ROOT  # noqa: E402,I100
import numpy as np  # noqa: E402

sys.path.insert(0, str(ROOT))

import models  # noqa: E402,I100
from closedloop_dynamics.core.types import EVALUATIONS  # noqa: E402,I100
from closedloop_dynamics.formats.registry import read_model  # noqa: E402
from closedloop_dynamics.mechanism.mechanism import MechanismError  # noqa: E402
from closedloop_dynamics.simulation.errors import SimulationError  # noqa: E402
from closedloop_dynamics.simulation.model_scene import assembled, scene_of_model  # noqa: E402
from closedloop_dynamics.simulation.scene import load_scene, scene_names  # noqa: E402
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402
from closedloop_dynamics.studies.reference import in_angles  # noqa: E402
from closedloop_dynamics.visual.tables import write_csv  # noqa: E402

SOURCE = 'https://github.com/Gepetto/example-parallel-robots'
ROBOTS = ('5bar_linkage', '5bar_linkage_iso3d', 'battobot_6d', 'cassie_like', 'digit_like',
          'digit_like_2legs', 'disney_like', 'robot_delta', 'talos_like', 'wl16_like')
TARGETS = (1e-3, 1e-6, 1e-9)
# Torques a second; 0: none, the machine is let go.
RATES = (0, 100, 1000)  # [Hz]
DURATION = 1.0  # [s]
OUTPUTS = 100
# What the torques would alone accelerate a drive by, on average, and how they swing.
PUSH, SWING = 2.0, 2.0  # [rad/s^2 or m/s^2], [Hz]
# The reference and what proves it: integrator, tolerance, formulation.
REFERENCES = (('dop853', 1e-13, 'subsystem'), ('dopri5', 1e-12, 'augmented'),
              ('dopri5', 1e-12, 'subsystem'), ('rodas4', 1e-10, 'augmented'))
# How well the reference must be known [rad or m]; less well only where it would be known for less
# than so much of the motion.
KNOWN, SHORTEST = (3e-10, 3e-7, 3e-4), 0.1
# Computing a motion is given up after so long, and not repeated where it takes longer [s].
PATIENCE, LONG = 8.0, 0.3
ROUNDS, QUICK_ROUNDS = 5, 2
OURS = 'default'
# Of the others: tolerances; steps of a free motion [s], and in the time of a held torque.
TOLERANCES, STEPS, PARTS = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-13), (1e-2, 1e-3, 1e-4), (1, 4, 10)
MUJOCO = ('RK4', 'implicitfast')
FREQUENCY, HARDEST = 0.3, 0.9999  # Of the springs of MuJoCo's loops, times the step; impedance
HEADER = ('machine', 'kind', 'rate', 'engine', 'setting', 'target', 'error',
          'cpu_time_per_second', 'evaluations_per_second', 'known_to', 'duration', 'note')


class Motion:
    """
    A motion of a machine that is known well.

    Parameters
    ----------
    scene : Scene
    rate : int
        Of ``RATES``.

    Attributes
    ----------
    torques : ndarray, shape (n, number of torque names)
        One after the other.
    position : ndarray, shape (outputs, nq)
    known : float
        How well [rad or m].
    duration : float
        As far as it is known [s].

    """

    def __init__(self, scene, rate):
        """Compute the reference, and prove it."""
        self.scene, self.rate = scene, rate
        first = Simulation(scene)
        self.coordinates = first.coordinates
        self.start = first.position.copy(), first.velocity.copy()
        self.torques = torques(first, rate)
        self.duration, found, why = DURATION, [], []
        for integrator, tolerance, formulation in REFERENCES:
            try:
                positions = self.run(
                    integrator=integrator, tolerance=tolerance, formulation=formulation)[0]
            except SimulationError as error:
                why.append(f'{integrator}: {error}')
                continue
            found.append(positions)
            if len(found) == 2:
                break
        if len(found) < 2:
            raise SimulationError('; '.join(why) or 'nothing proves the reference')
        self.position = found[0]
        apart = np.array([np.abs(in_angles(self.coordinates, *pair)).max(initial=0.0)
                          for pair in zip(*found)])
        for self.known in KNOWN:
            beyond = np.flatnonzero(~(apart <= self.known))
            outputs = int(beyond[0]) if len(beyond) else len(apart)
            if outputs >= SHORTEST * OUTPUTS:
                break
        else:
            raise SimulationError('two methods do not agree')
        self.position = self.position[:outputs]
        self.duration = DURATION * outputs / OUTPUTS
        self.torques = self.torques[:round(self.duration * rate) or 1]

    def simulation(self, **method):
        """Return a simulation by a method, its steps as long as torques are held."""
        step = 1.0 / self.rate if self.rate else DURATION / OUTPUTS
        simulation = Simulation(replace(self.scene, method=replace(
            self.scene.method.without_budget, step_size=step, stabilisation='projection',
            baumgarte_time_constant=None, **method)))
        simulation.monitor.sampling = False
        return simulation

    def run(self, **method):
        """Return positions at the outputs, and the simulation at the end."""
        simulation, positions = self.simulation(**method), []
        begin = time.thread_time()
        every = max(1, self.rate * round(DURATION * 1e3) // (OUTPUTS * 1000))
        for number in range(round(self.duration * self.rate) or round(
                self.duration * OUTPUTS / DURATION)):
            simulation.advance(self.torques[min(number, len(self.torques) - 1)], 1)
            if (number + 1) % every == 0:
                positions.append(simulation.position.copy())
                if time.thread_time() - begin > PATIENCE:
                    raise SimulationError(f'{PATIENCE:g} s of computing were not enough')
        return np.array(positions), simulation

    def error(self, positions):
        """Return the largest error of positions at the outputs."""
        return max(float(np.abs(in_angles(self.coordinates, *pair)).max(initial=0.0))
                   for pair in zip(positions, self.position))

    def time_once(self, simulation):
        """Return the CPU time of the motion [s]."""
        simulation.reset()
        simulation.monitor.sampling = False
        steps = 1 if self.rate else round(self.duration * OUTPUTS / DURATION)
        begin = time.thread_time()
        for torque in self.torques:
            simulation.advance(torque, steps)
        return time.thread_time() - begin


def torques(simulation, rate):
    """Return torques that are held one after the other, as ``advance`` takes them."""
    if not rate:
        return simulation.joint_torques(None)[np.newaxis]
    mean, state = {}, (simulation.position, simulation.velocity)
    still = simulation.forward_dynamics(*state)[0]
    rates = simulation.mechanism.coordinates.rates
    for joint in simulation.actuated_joints:
        if joint in rates and rates[joint].stop == rates[joint].start + 1:
            moved = simulation.forward_dynamics(*state, {joint: 1.0})[0] - still
            response = abs(float(moved[rates[joint].start]))
            if response > 1e-9:
                mean[joint] = PUSH / response
    if not mean:
        raise SimulationError('no drives')
    swing = 1.0 + np.cos(2.0 * np.pi * SWING * np.arange(round(DURATION * rate)) / rate)
    whole = simulation.joint_torques(mean)
    return swing[:, np.newaxis] * whole


def row(motion, engine, setting, error, cost, evaluations=math.nan, target=math.nan, note=''):
    """Return what is reported of a run, without its machine."""
    return {'rate': motion.rate, 'engine': engine, 'setting': setting, 'target': target,
            'error': error, 'cpu_time_per_second': cost, 'evaluations_per_second': evaluations,
            'known_to': motion.known, 'duration': motion.duration, 'note': note}


def ours(motion, rounds):
    """Yield the rows of the default method."""
    for target in TARGETS:
        try:
            positions, simulation = motion.run(integrator='auto', accuracy=target)
            evaluations = simulation.system.work.health[EVALUATIONS]
            costs = [motion.time_once(simulation)]
            while len(costs) < rounds and sum(costs) < LONG:
                costs.append(motion.time_once(simulation))
        except SimulationError as error:
            yield row(motion, OURS, f'accuracy {target:.0e}', math.nan, math.nan, target=target,
                      note=str(error))
            continue
        yield row(motion, OURS, f'accuracy {target:.0e}', motion.error(positions),
                  min(costs) / motion.duration, evaluations / motion.duration, target)


def pinocchios(path, scene, gravity):
    """Return {algorithm: (machine in C++, coordinates of ours, efforts of ours)}."""
    found = {}
    if path is not None:
        import model_pinocchio
        for algorithm in model_pinocchio.SETTINGS:
            one = model_pinocchio.Pinocchio(path, scene.mechanism, gravity, algorithm=algorithm)
            found[algorithm] = one.machine, one.state, one.efforts
        return found
    import peer_cases
    import peer_pinocchio
    # Joints depth first, and about no negative axes.
    ordered = peer_cases.load_scene(scene.name)
    engine = peer_pinocchio.Engine(ordered)
    ours, theirs = ({joint.name: joint for joint in one.mechanism.joints}
                    for one in (scene, ordered))
    places, rates, turned = [], [], []
    for name, joint in theirs.items():
        spans = (scene.mechanism.coordinates.coordinates[name],
                 scene.mechanism.coordinates.rates[name])
        for span, indices in zip(spans, (places, rates)):
            indices += range(span.start, span.stop)
        turned += [1.0 if joint.axis == ours[name].axis else -1.0] * (
            spans[1].stop - spans[1].start)
    turned = np.array(turned)
    # Only joints of one degree of freedom are turned round, in the plane and in space.
    signs = turned if len(places) == len(rates) else np.ones(len(places))
    if len(places) != len(rates) and (turned < 0.0).any():
        raise ValueError('joints are turned round beside balls')
    for name, machine in {'constraintDynamics': engine._loops, **engine._by_bodies}.items():
        if machine and name in ('constraintDynamics', 'lcaba'):
            found[name] = (machine, lambda q, qd: (signs * q[places], turned * qd[rates]),
                           lambda tau: turned * tau[rates])
    return found


def timed(run, apart, rounds):
    """Return error and least CPU time [s] of a run, which returns coordinates."""
    costs = []
    while not costs or len(costs) < rounds and sum(costs) < LONG:
        begin = time.thread_time()
        end = run()
        costs.append(time.thread_time() - begin)
    return apart(end), min(costs)


def of_pinocchio(motion, machines, rounds):
    """Yield the rows of Pinocchio."""
    nv = motion.coordinates.nv
    first = 1.0 / motion.rate if motion.rate else motion.duration / OUTPUTS
    for name, (machine, state, efforts) in machines.items():
        start, end = state(*motion.start), state(motion.position[-1], np.zeros(nv))[0]
        held = [np.ascontiguousarray(efforts(torque[:nv])) for torque in motion.torques]
        span = 1.0 / motion.rate if motion.rate else motion.duration
        plans = [(f'Fehlberg 7(8), tolerance {value:.0e}', ('fehlberg_78', span, value, first))
                 for value in TOLERANCES]
        plans += [(f'RK4, step {span / count:g} s', ('runge_kutta_4', span / count, count))
                  for count in (PARTS if motion.rate else [
                      max(1, round(span / step)) for step in STEPS])]
        longest = {}
        for setting, plan in plans:
            if longest.get(plan[0], 0.0) > LONG:
                # What is finer takes longer.
                continue

            def run(plan=plan):
                machine.set_state(*start, held[0])
                machine.held(held, plan)
                return machine.position()

            error, cost = timed(run, lambda q: float(np.abs(q - end).max()), rounds)
            longest[plan[0]] = cost
            yield row(motion, 'Pinocchio', f'{name}, {setting}', error, cost / motion.duration)


def of_mujoco(motion, gravity, rounds):
    """Yield the rows of MuJoCo, from a model that is written for it."""
    import mujoco
    from closedloop_dynamics.formats.mjcf_writing import mjcf
    # What goes wrong shows in the result; no file MUJOCO_LOG.TXT is wanted.
    mujoco.set_mju_user_warning(lambda message: None)
    effects = {'gravity': {'type': 'gravity', 'acceleration': (*gravity, 0.0)[:3]}}
    mechanism = motion.scene.mechanism
    keys = [mujoco.MjModel.from_xml_string(mjcf(mechanism, effects, q)).key_qpos[0].copy()
            for q in (motion.start[0], motion.position[-1])]
    model = mujoco.MjModel.from_xml_string(mjcf(mechanism, effects))
    if model.nv != motion.coordinates.nv:
        raise ValueError('joints are written as several')
    for off in ('CONTACT', 'LIMIT', 'FRICTIONLOSS', 'ACTUATION', 'SPRING', 'DAMPER', 'REFSAFE'):
        model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f'mjDSBL_{off}')
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    model.opt.solver, model.opt.iterations = mujoco.mjtSolver.mjSOL_NEWTON, 1
    model.opt.tolerance = 1e-14
    model.eq_solimp[:] = HARDEST, HARDEST, 1e-3, 0.5, 2.0
    data = mujoco.MjData(model)
    order = _order(model, mechanism)
    held = np.zeros((len(motion.torques), model.nv))
    held[:, order] = motion.torques[:, :model.nv]
    span = 1.0 / motion.rate if motion.rate else motion.duration

    def apart(position):
        difference = np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, difference, 1.0, keys[1], position)
        return float(np.abs(difference).max())

    for integrator in MUJOCO:
        model.opt.integrator = getattr(mujoco.mjtIntegrator, f'mjINT_{integrator.upper()}')
        for count in sorted({max(1, round(span / longest)) for longest in STEPS}):
            step = model.opt.timestep = span / count
            model.eq_solref[:] = -(FREQUENCY / step) ** 2, -2.0 * FREQUENCY / step

            def run(count=count):
                mujoco.mj_resetData(model, data)
                data.qpos[:], data.qvel[order] = keys[0], motion.start[1]
                for torque in held:
                    data.qfrc_applied[:] = torque
                    mujoco.mj_step(model, data, count)
                bad = data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number
                return np.full(model.nq, np.nan) if bad else data.qpos.copy()

            error, cost = timed(run, apart, rounds)
            yield row(motion, 'MuJoCo', f'{integrator}, step {step:g} s', error,
                      cost / motion.duration)


def _order(model, mechanism):
    """Return where our rates are in MuJoCo's, whose joints follow the tree in depth."""
    import mujoco
    order = []
    for joint in mechanism.joints:
        span = mechanism.coordinates.rates[joint.name]
        width = span.stop - span.start
        for name in (joint.name, *(f'{joint.name}_{k + 1}' for k in range(width))):
            number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
            if number >= 0:
                first = int(model.jnt_dofadr[number])
                order += range(first, first + (width if name == joint.name else 1))
    if sorted(order) != list(range(model.nv)):
        raise ValueError('joints are written otherwise than ours')
    return order


def measured(name, path, rounds):
    """Return the rows of a machine: the default method's, and those of others that know it."""
    scene = load_scene(name) if path is None else None
    gravity, rows, bare, files = (0.0, 0.0, 0.0), [], scene, None
    if path is not None:
        imported, found, notes = assembled(read_model(path))
        if not found.closed:
            raise SimulationError(' '.join(notes))
        scene = scene_of_model(path, imported)
        # As its authors wrote it, moved by gravity alone.
        scene = bare = replace(scene, effects={
            key: effect for key, effect in scene.effects.items()
            if type(effect).__name__ == 'Gravity'})
        files = path
    for effect in scene.effects.values():
        if type(effect).__name__ == 'Gravity':
            gravity = tuple(effect.acceleration)
    motions = []
    for rate in RATES:
        try:
            motions.append(Motion(scene, rate))
        except SimulationError as error:
            rows.append({'rate': rate, 'engine': OURS, 'note': str(error)})
    for motion in motions:
        rows += ours(motion, rounds)
    for one in (OF_PINOCCHIO, OF_MUJOCO):
        try:
            for motion in motions:
                rows += one(motion, files, bare, gravity, rounds)
        except Exception as error:  # noqa: B902 - what another simulator does not know has no row
            rows.append({'rate': 0, 'engine': one.__name__.title(), 'note': str(error)})
    kind = 'scene' if path is None else 'robot'
    return [{'machine': name, 'kind': kind, **each} for each in rows]


def pinocchio(motion, path, scene, gravity, rounds):
    """Return the rows of Pinocchio."""
    return list(of_pinocchio(motion, pinocchios(path, scene, gravity), rounds))


def mujoco(motion, path, scene, gravity, rounds):
    """Return the rows of MuJoCo."""
    return list(of_mujoco(motion, gravity, rounds))


OF_PINOCCHIO, OF_MUJOCO = pinocchio, mujoco


def robots(directory):
    """Return {name: file} of the robots that are found in a folder."""
    found = {}
    for path in models.files(directory) if directory else ():
        name = models.name_of(path)
        if name in ROBOTS:
            # Not those that its authors have put aside.
            if 'old' not in path.parts:
                found.setdefault(name, path)
    return {name: found[name] for name in ROBOTS if name in found}


def write(rows, path):
    """Write all rows as a CSV file."""
    write_csv(path, HEADER, [tuple(each.get(key, '') for key in HEADER) for each in rows])


def read(path):
    """Return the rows of a CSV file, numbers as numbers."""
    with open(path, newline='', encoding='utf-8') as file:
        return [{key: value if key in ('machine', 'kind', 'engine', 'setting', 'note')
                 else float(value or 'nan') for key, value in each.items()}
                for each in csv.DictReader(file)]


def main(arguments=None):
    """Measure and write; see the module."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('machines', nargs='*', help='default: all')
    parser.add_argument('--models', type=Path, metavar='DIR',
                        help=f'with a clone of {SOURCE}; without it no robots')
    parser.add_argument('--quick', action='store_true', help='fewer rounds')
    parser.add_argument('--output', type=Path, default=ROOT / 'benchmark_output', metavar='DIR',
                        help='where results go; machines measured there at this commit are not '
                        'measured again (default: %(default)s)')
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    kept = options.output / 'all_machines.json'
    result = json.loads(kept.read_text()) if kept.exists() else {}
    if (result.get('commit'), result.get('quick')) != (commit(), options.quick):
        result = {'commit': commit(), 'quick': options.quick, 'machine': description(),
                  'machines': {}}
    # How far off runs are stands in the table, and robots are read as models.py tells.
    warnings.simplefilter('ignore')
    paths = {**dict.fromkeys(sorted(scene_names())), **robots(options.models)}
    for name, path in paths.items():
        if name in result['machines'] or options.machines and name not in options.machines:
            continue
        begin = time.process_time()
        try:
            rows = measured(name, path, QUICK_ROUNDS if options.quick else ROUNDS)
        except (SimulationError, MechanismError, ValueError) as error:
            rows = [{'machine': name, 'kind': 'scene' if path is None else 'robot', 'rate': 0,
                     'engine': OURS, 'note': str(error)}]
        result['machines'][name] = rows
        kept.write_text(json.dumps(result, indent=1))
        print(f'{name}: {time.process_time() - begin:.1f} s', file=sys.stderr, flush=True)
    write([each for rows in result['machines'].values() for each in rows],
          options.output / 'all_machines.csv')
    return 0


if __name__ == '__main__':
    sys.exit(main())
