# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What accuracy costs on every shipped scene, and on ten robots that others have published.

Each machine moves freely from its start, and under torques that swing and are held at 100 Hz and
at 1 kHz. The default method is asked for an accuracy of 1e-3, 1e-6 and 1e-9; beside it stand
Pinocchio (constraintDynamics and lcaba, RK4 and Runge-Kutta-Fehlberg 7(8) in C++) and MuJoCo (RK4
and implicitfast, its loops as stiff as the step allows) wherever they can be told the machine with
all its effects: the cheapest of their settings that keeps the error, found by bisection on four
settings a decade. No time is taken before accelerations agree with ours; where they do not, the
benchmark is wrong and ends.

The motion that errors are measured against is that of dop853 with a tolerance of 1e-13; dopri5
with another integrator shows how far and how well it is known. CPU time of one thread; of held
torques that of a loop in Python that makes a call for each of them. Robots are found by name in a
folder with a clone of example-parallel-robots and left out without it.
"""

import argparse
import csv
from dataclasses import asdict, replace
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
from peer_errors import CannotExpress, Disagreement, NotAdapted  # noqa: E402

sys.path.insert(0, str(ROOT))

import models  # noqa: E402,I100
from closedloop_dynamics.core.types import EVALUATIONS  # noqa: E402,I100
from closedloop_dynamics.effects.registry import effect_type  # noqa: E402
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
# The reference and what proves it: integrator, tolerance.
REFERENCES = (('dop853', 1e-13), ('dopri5', 1e-12), ('rodas4', 1e-10))
# How well the reference must be known [rad or m]; less well only where it would be known for less
# than so much of the motion.
KNOWN, SHORTEST = (3e-10, 3e-7, 3e-4), 0.1
# Computing a motion is given up after so long, and not repeated where it takes longer [s].
PATIENCE, LONG = 8.0, 0.3
ROUNDS, QUICK_ROUNDS = 5, 2
OURS = 'default'
# Of the others: tolerances and steps [s], the coarsest and the finest, and how many a decade.
TOLERANCES, STEPS, PER_DECADE = (1e-1, 1e-13), (1e-1, 1e-5), 4
# No setting is tried that is finer than one whose motion takes so long [s].
LONGEST = 0.6
MUJOCO = ('RK4', 'implicitfast')
# Where accelerations are compared: states, how far from the start [rad or m], their rates [rad/s
# or m/s] and torques [N m or N]; what they may differ by, relative, and where loops are soft,
# after extrapolation.
STATES, APART, FAST = 3, 0.05, 1.0
AGREED, AGREED_SOFT = 1e-5, 1e-3
# What moves less than this stands still [rad or m].
STILL = 1e-6
FREQUENCY, HARDEST = 0.3, 0.9999  # Of the springs of MuJoCo's loops, times the step; impedance
# How soft loops are where accelerations are compared, over the hardest.
SOFTER = 1.0, 1.4, 2.0, 2.8, 4.0
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
        for integrator, tolerance in REFERENCES:
            try:
                positions = self.run(integrator=integrator, tolerance=tolerance)[0]
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
        self.still = float(np.abs(self.position - self.start[0]).max()) < STILL
        self.duration = DURATION * outputs / OUTPUTS
        self.torques = self.torques[:round(self.duration * rate) or 1]

    def simulation(self, **method):
        """Return a simulation by a method, its steps as long as torques are held."""
        step = 1.0 / self.rate if self.rate else DURATION / OUTPUTS
        simulation = Simulation(replace(self.scene, method=replace(
            self.scene.method.without_budget, step_size=step, stabilisation='projection',
            baumgarte_time_constant=None, **method)))
        simulation.stepping.monitor.sampling = False
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
        simulation.stepping.monitor.sampling = False
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
            'known_to': motion.known, 'duration': motion.duration,
            'note': note or ('stands still' if motion.still else '')}


def ours(motion, rounds):
    """Yield the rows of the default method."""
    for target in TARGETS:
        try:
            positions, simulation = motion.run(integrator='auto', accuracy=target)
            evaluations = simulation.data.system.work.health[EVALUATIONS]
            costs = [motion.time_once(simulation)]
            while len(costs) < rounds and sum(costs) < LONG:
                costs.append(motion.time_once(simulation))
        except SimulationError as error:
            yield row(motion, OURS, f'accuracy {target:.0e}', math.nan, math.nan, target=target,
                      note=str(error))
            continue
        yield row(motion, OURS, f'accuracy {target:.0e}', motion.error(positions),
                  min(costs) / motion.duration, evaluations / motion.duration, target)


def states(scene):
    """Return closed states beside a scene's start under torques: (q, qd, tau, qdd) of ours."""
    rng, simulation, found = np.random.default_rng(1), Simulation(scene), []
    mechanism, coordinates = scene.mechanism, scene.mechanism.coordinates
    start = simulation.position.copy()
    while len(found) < STATES:
        simulation.set_state(
            coordinates.moved(start, rng.uniform(-APART, APART, coordinates.nv)),
            rng.uniform(-FAST, FAST, coordinates.nv))
        driven = [name for name in simulation.actuated_joints if name in mechanism.joint_names]
        tau = simulation.joint_torques(dict.fromkeys(driven, FAST))
        state = simulation.position.copy(), simulation.velocity.copy()
        found.append((*state, tau[:coordinates.nv], simulation.forward_dynamics(
            *state, dict.fromkeys(driven, FAST))[0].copy()))
    return found


def require_agreement(who, scene, acceleration, largest):
    """Raise Disagreement where accelerations of another simulator differ from ours."""
    for q, qd, tau, expected in states(scene):
        apart = float(np.abs(acceleration(q, qd, tau) - expected).max()
                      / np.abs(expected).max())
        # Not a number is a disagreement, too.
        if not apart <= largest:
            raise Disagreement(f'{scene.name} in {who}: accelerations differ from ours by '
                               f'{apart:.2g}, relative; at most {largest:g} was expected')


def timed(run, apart, rounds):
    """Return error and least CPU time [s] of a run, which returns coordinates."""
    costs = []
    while not costs or len(costs) < rounds and sum(costs) < LONG:
        begin = time.thread_time()
        end = run()
        costs.append(time.thread_time() - begin)
    return apart(end), min(costs)


def ladder(coarsest, finest):
    """Return settings from coarse to fine."""
    count = round(PER_DECADE * math.log10(coarsest / finest))
    return [coarsest * 10.0 ** (-number / PER_DECADE) for number in range(count + 1)]


def bisected(measure, count):
    """
    Measure those of ``count`` settings, coarse to fine, which find the coarsest for each target.

    Parameters
    ----------
    measure : callable
        Takes the number of a setting; returns its error and its CPU time [s].
    count : int
        How many settings there are.

    Returns
    -------
    dict of int to (float, float)
        What was measured.

    """
    found, last = {}, count

    def keeps(number, target):
        nonlocal last
        if number >= last:
            return False
        if number not in found:
            found[number] = measure(number)
            if found[number][1] > LONGEST:
                # What is finer takes longer.
                last = min(last, number + 1)
        return found[number][0] <= target

    least = 0
    for target in TARGETS:
        low, high = least - 1, count
        while high - low > 1:
            middle = (low + high) // 2
            if keeps(middle, target):
                high = middle
            elif middle >= last:
                # Too fine to be tried; a coarser one may do.
                high = middle
            else:
                low = middle
        least = max(low, 0)
    return found


def of_pinocchio(motions, path, scene, gravity, rounds):
    """Yield the rows of Pinocchio."""
    import model_pinocchio
    from model_pinocchio import Pinocchio
    others = [name for name, effect in scene.effects.items()
              if type(effect).__name__ != 'Gravity']
    if others:
        raise CannotExpress(f'effects ({", ".join(others)})')
    for name in model_pinocchio.SETTINGS:
        machine = Pinocchio.built(scene.mechanism, gravity, name) if path is None else (
            Pinocchio.read(path, scene.mechanism, gravity, algorithm=name))
        try:
            require_agreement(f'Pinocchio, {name}', scene, machine.evaluate, AGREED)
        except Disagreement as error:
            if name == 'constraintDynamics':
                raise
            # It was told the machine that another algorithm of the library knows.
            yield {'rate': 0, 'engine': 'Pinocchio', 'setting': name,
                   'note': f'wrong by this algorithm: {error}'}
            continue
        for motion in motions:
            yield from pinocchio_rows(motion, name, machine, rounds)


def pinocchio_rows(motion, name, built, rounds):
    """Yield the rows of a motion by an algorithm of Pinocchio."""
    machine, nv = built.machine, motion.coordinates.nv
    span = 1.0 / motion.rate if motion.rate else motion.duration
    start, end = built.state(*motion.start), built.state(motion.position[-1], np.zeros(nv))[0]
    held = [np.ascontiguousarray(built.efforts(torque[:nv])) for torque in motion.torques]
    first = span if motion.rate else motion.duration / OUTPUTS
    counts = steps_of(span)
    methods = {
        'Fehlberg 7(8), tolerance': [
            (f'{value:.1e}', ('fehlberg_78', span, value, first))
            for value in ladder(*TOLERANCES)],
        'RK4, step': [(f'{span / count:.3g} s', ('runge_kutta_4', span / count, count))
                      for count in counts]}
    for method, plans in methods.items():
        def measure(number, plans=plans):
            def run():
                machine.set_state(*start, held[0])
                machine.held(held, plans[number][1])
                return machine.position()
            return timed(run, lambda q: float(np.abs(q - end).max()), rounds)

        for number, (error, cost) in sorted(bisected(measure, len(plans)).items()):
            yield row(motion, 'Pinocchio', f'{name}, {method} {plans[number][0]}', error,
                      cost / motion.duration)


def steps_of(span):
    """Return numbers of steps in a time [s], few to many."""
    return sorted({max(1, round(span / step)) for step in ladder(*STEPS)})


def of_mujoco(motions, _, scene, gravity, rounds):
    """Yield the rows of MuJoCo, from a model that is written for it."""
    import mujoco
    from closedloop_dynamics.formats.mjcf_writing import mjcf
    # What goes wrong shows in the result; no file MUJOCO_LOG.TXT is wanted.
    mujoco.set_mju_user_warning(lambda message: None)
    mechanism, left = scene.mechanism, {}
    effects = {name: {'type': effect_type(effect), **asdict(effect)}
               for name, effect in scene.effects.items()}
    try:
        model = mujoco.MjModel.from_xml_string(mjcf(mechanism, effects, left_out=left))
    except MechanismError as error:
        raise NotAdapted(error) from error
    left = [name for name in left if effects[name]['type'] != 'gravity']
    if left:
        raise CannotExpress(f'effects ({", ".join(left)})')
    if model.nv != mechanism.coordinates.nv:
        raise NotAdapted('a joint is written as several of other coordinates')
    for off in ('CONTACT', 'ACTUATION', 'REFSAFE', 'ISLAND', 'WARMSTART'):
        model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f'mjDSBL_{off}')
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    model.opt.solver, model.opt.iterations = mujoco.mjtSolver.mjSOL_NEWTON, 1
    model.opt.tolerance = 1e-14
    data, order = mujoco.MjData(model), _order(model, mechanism)

    def position(q):
        whole = mjcf(mechanism, effects, q)
        return mujoco.MjModel.from_xml_string(whole).key_qpos[0].copy()

    def acceleration(q, qd, tau):
        found = []
        place = position(q)
        for softness in (1.0 - HARDEST) * np.array(SOFTER):
            model.eq_solimp[:] = 1.0 - softness, 1.0 - softness, 1e-3, 0.5, 2.0
            # No spring for a time: rates are what they are, positions as well.
            model.eq_solref[:] = -1e6, -2e3
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[order], data.qfrc_applied[order] = place, qd, tau
            mujoco.mj_forward(model, data)
            found.append(data.qacc[order].copy())
        # The polynomial through them, where loops are hard.
        return np.polynomial.polynomial.polyfit(SOFTER, found, len(SOFTER) - 1)[0]

    require_agreement('MuJoCo', scene, acceleration, AGREED_SOFT)
    model.eq_solimp[:] = HARDEST, HARDEST, 1e-3, 0.5, 2.0
    for motion in motions:
        yield from mujoco_rows(motion, mujoco, model, order, position, rounds)


def mujoco_rows(motion, mujoco, model, order, position, rounds):
    """Yield the rows of a motion in MuJoCo."""
    data = mujoco.MjData(model)
    start, end = position(motion.start[0]), position(motion.position[-1])
    held = np.zeros((len(motion.torques), model.nv))
    held[:, order] = motion.torques[:, :model.nv]
    span = 1.0 / motion.rate if motion.rate else motion.duration
    counts = steps_of(span)

    def apart(place):
        difference = np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, difference, 1.0, end, place)
        return float(np.abs(difference).max())

    def measure(number):
        step = model.opt.timestep = span / counts[number]
        model.eq_solref[:] = -(FREQUENCY / step) ** 2, -2.0 * FREQUENCY / step

        def run():
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[order] = start, motion.start[1]
            for torque in held:
                data.qfrc_applied[:] = torque
                mujoco.mj_step(model, data, counts[number])
            bad = data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number
            return np.full(model.nq, np.nan) if bad else data.qpos.copy()

        return timed(run, apart, rounds)

    for integrator in MUJOCO:
        model.opt.integrator = getattr(mujoco.mjtIntegrator, f'mjINT_{integrator.upper()}')
        for number, (error, cost) in sorted(bisected(measure, len(counts)).items()):
            yield row(motion, 'MuJoCo', f'{integrator}, step {span / counts[number]:.3g} s', error,
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
        raise NotAdapted('joints are written otherwise than ours')
    return order


def measured(name, path, rounds):
    """Return the rows of a machine: the default method's, and those of others that know it."""
    if path is None:
        scene = load_scene(name)
    else:
        imported, found, notes = assembled(read_model(path))
        if not found.closed:
            raise SimulationError(' '.join(notes))
        scene = scene_of_model(path, imported)
        # As its authors wrote it, moved by gravity alone.
        scene = replace(scene, effects={
            key: effect for key, effect in scene.effects.items()
            if type(effect).__name__ == 'Gravity'})
    gravity = next((tuple(effect.acceleration) for effect in scene.effects.values()
                    if type(effect).__name__ == 'Gravity'), (0.0, 0.0, 0.0))
    rows, motions = [], []
    for rate in RATES:
        try:
            motions.append(Motion(scene, rate))
        except SimulationError as error:
            rows.append({'rate': rate, 'engine': OURS, 'note': str(error)})
    for motion in motions:
        rows += ours(motion, rounds)
    moving = [motion for motion in motions if not motion.still]
    for engine, rows_of in PEERS.items():
        try:
            rows += rows_of(moving, path, scene, gravity, rounds)
        except (CannotExpress, NotAdapted) as error:
            rows.append({'rate': 0, 'engine': engine, 'note': f'{error.text}: {error}'})
        except ImportError as error:
            rows.append({'rate': 0, 'engine': engine, 'note': f'not installed: {error}'})
    kind = 'scene' if path is None else 'robot'
    return [{'machine': name, 'kind': kind, **each} for each in rows]


PEERS = {'Pinocchio': of_pinocchio, 'MuJoCo': of_mujoco}


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
        except (SimulationError, MechanismError) as error:
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
