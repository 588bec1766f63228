# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Code that CasADi generates for one mechanism, beside us.

What an expert writes for a mechanism without this package: the inertia matrix by composite bodies,
bias forces by Newton and Euler's equations, loops as rows below them, and a sparse LDL
factorization of the whole, from the leaves of the tree to its root. Sines and cosines of all
joints are computed first. Compiled by gcc for this processor, and called in a loop of C. Which
equations repeat others is decided once; at singular positions of the mechanism it fails.
"""

from collections import Counter
import ctypes
from dataclasses import dataclass
from pathlib import Path
import tempfile

import casadi as ca
import numpy as np
from peer_cases import NotAdapted, random_states, run_compiler
from scipy.linalg import qr

from closedloop_dynamics.formats.in_space import in_space  # noqa: I100
from closedloop_dynamics.mechanism.inertia import inertia_matrix
from closedloop_dynamics.mechanism.mechanism import (
    GROUND, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL)
from closedloop_dynamics.mechanism.rotations import of_quaternion

NAME = 'KKT system by CasADi'
# What the code is compiled with; so declared, gcc computes sines in vectors.
VECTORS = '-DVECTOR=__attribute__((simd("notinbranch")))', '-fno-math-errno'
BUILDS = {f'gcc {level}, sines {kind}': (level, *sines) for level in ('-O3', '-Ofast')
          for kind, sines in (('of libm', ('-DVECTOR=',)), ('in vectors', VECTORS))}
LANES = 4
# Of a Jacobian, relative: pivots below are those of equations that repeat others.
REPEATED = 1e-9
OPERATIONS = {ca.OP_ADD: 'add', ca.OP_SUB: 'add', ca.OP_MUL: 'multiply', ca.OP_SQ: 'multiply',
              ca.OP_TWICE: 'multiply', ca.OP_DIV: 'divide', ca.OP_INV: 'divide'}
# As the engine's own loop: each evaluation waits for the one before. ``zero`` is 0.
LOOP = """
VECTOR double sin(double);
VECTOR double cos(double);
static const int place[] = {{{places}}};
void evaluate_again(double *q, const double *qd, const double *tau, double *qdd, long count,
                    double zero)
{{
  static double angle[{lanes}], cosine[{lanes}], sine[{lanes}];
  const double *in[] = {{q, qd, tau, cosine, sine}};
  double *out[] = {{qdd}};
  for (long n = 0; n < count; ++n) {{
    for (int k = 0; k < {angles}; ++k) angle[k] = q[place[k]];
    for (int k = 0; k < {lanes}; ++k) cosine[k] = cos(angle[k]);
    for (int k = 0; k < {lanes}; ++k) sine[k] = sin(angle[k]);
    accelerate(in, out, 0, 0, 0);
    for (int k = 0; k < {freedoms}; ++k) q[k] += zero * qdd[k];
  }}
}}
"""


def thin(matrix):
    """Return a matrix of symbols without entries that are zero."""
    return ca.sparsify(ca.SX(matrix))


def times(*factors):
    """Return the product of matrices."""
    result = factors[0]
    for factor in factors[1:]:
        result = thin(ca.mtimes(result, factor))
    return result


def hat(vector):
    """Return the matrix that makes cross products with a vector."""
    return thin(ca.skew(vector))


@dataclass
class Link:
    """
    A body behind a joint, in its own frame; and how it moves.

    Attributes
    ----------
    parent : Link or None
        None on the ground.
    rates : list of int
        Of its joint.
    turn, position : SX, shapes (3, 3) and (3, 1)
        Of its frame in its parent's.
    about, along : SX, shape (3, number of rates)
        Angular and linear velocity by rate.
    mass, moment, inertia : SX, shapes (1, 1), (3, 1) and (3, 3)
        Mass, mass times place of its centre, inertia about its origin; in the end those of all
        that it carries.

    """

    parent: object
    rates: list
    turn: ca.SX
    position: ca.SX
    about: ca.SX
    along: ca.SX
    mass: ca.SX
    moment: ca.SX
    inertia: ca.SX

    def move(self, qd, rest):
        """Compute velocity, acceleration at ``qdd`` = 0 and pose; ``rest``: of the ground."""
        back, own = thin(self.turn.T), times(self.about, qd[self.rates])
        self.spin, turning, pulled = own, ca.SX(3, 1), rest
        self.pose, self.place = self.turn, self.position
        if self.parent is not None:
            carried = times(back, self.parent.spin)
            self.spin = thin(carried + own)
            turning = thin(times(back, self.parent.turning) + times(hat(carried), own))
            pulled = self.parent.pulled + times(self.parent.bend, self.position)
            self.pose = times(self.parent.pose, self.turn)
            self.place = thin(self.parent.place + times(self.parent.pose, self.position))
        sliding = times(hat(self.spin), self.along, qd[self.rates])
        self.turning, self.pulled = turning, thin(times(back, pulled) + 2.0 * sliding)
        # What a point of the body is accelerated by more than its origin, over its place.
        self.bend = thin(hat(turning) + times(hat(self.spin), hat(self.spin)))
        self.force = thin(self.mass * self.pulled + times(self.bend, self.moment))
        self.torque = thin(times(self.inertia, turning) + times(hat(self.moment), self.pulled)
                           + times(hat(self.spin), self.inertia, self.spin))

    def joint_force(self, torque, force):
        """Return what a torque and a force at its origin are for its joint."""
        return thin(times(self.about.T, torque) + times(self.along.T, force))

    def to_parent(self, torque, force):
        """Return a torque and a force at its origin, at that of its parent."""
        force = times(self.turn, force)
        return thin(times(self.turn, torque) + times(hat(self.position), force)), force

    def add_to_parent(self):
        """Add forces and inertia to those of the parent."""
        parent, shift = self.parent, hat(self.position)
        torque, force = self.to_parent(self.torque, self.force)
        parent.torque, parent.force = thin(parent.torque + torque), thin(parent.force + force)
        moment = times(self.turn, self.moment)
        mixed = times(shift, hat(moment))
        whole = thin(parent.inertia + times(self.turn, self.inertia, self.turn.T)
                     - mixed - mixed.T - self.mass * times(shift, shift))
        # Symmetric: nothing is computed twice.
        parent.inertia = ca.tril2symm(ca.tril(whole))
        parent.moment = thin(parent.moment + moment + self.mass * self.position)
        parent.mass = parent.mass + self.mass


class System:
    """
    The equations of a machine under gravity.

    Parameters
    ----------
    machine : peer_cases.Machine

    Attributes
    ----------
    function : casadi.Function
        Accelerations of coordinates, rates, torques, and cosines and sines of ``angles``.
    angles : list of int
        Coordinates that are angles.

    Raises
    ------
    CannotExpress, NotAdapted
        Where the machine has parts that are not known here.

    """

    def __init__(self, machine):
        mechanism, self._links, self.angles = in_space(machine.mechanism), [], []
        machine.require_gravity_alone()
        if mechanism.couplings or not mechanism.cut_joints:
            raise NotAdapted('couplings of joints, or no loops')
        names = mechanism.coordinates
        symbols = [ca.SX.sym(*one) for one in (
            ('q', names.nq), ('qd', names.nv), ('tau', names.nv), ('c', names.nv),
            ('s', names.nv))]
        q, qd, tau, self._cosines, self._sines = symbols
        rest = -ca.SX(machine.gravity)
        last, bodies = {GROUND: None}, {body.name: body for body in mechanism.bodies}
        for joint in mechanism.joints:
            last[joint.child] = self._linked(joint, bodies[joint.child], last[joint.parent], q,
                                             names.coordinates[joint.name].start)
        for link in self._links:
            link.move(qd, thin(rest))
        rows, biases = (ca.vertcat(*parts) for parts in zip(*self._closed(
            mechanism, machine.mechanism.planar, last, rest)))
        state, turns = random_states(machine.scene, 1)[0], np.zeros((2, names.nv))
        angles = state[0][self.angles]
        turns[:, :len(angles)] = np.cos(angles), np.sin(angles)
        jacobian = np.array(ca.Function('rows', symbols, [rows])(*state, *turns))
        _, triangle, order = qr(jacobian.T, mode='economic', pivoting=True)
        pivots = np.abs(np.diag(triangle))
        kept = sorted(order[:int(np.sum(pivots > REPEATED * pivots.max()))].tolist())
        self.function = ca.Function('accelerate', symbols, ca.cse([
            self._accelerated(tau, rows[kept, :], biases[kept])]))

    def _linked(self, joint, body, parent, q, first):
        """Return the last link of a joint, made of as many as it has axes."""
        turn = of_quaternion(joint.orientation)
        turn = thin(np.where(np.abs(turn - np.round(turn)) < 1e-14, np.round(turn), turn))
        position, nothing = thin(np.array(joint.position)), ca.SX(3, 3)
        center = np.array(body.center_of_mass)
        inertia = inertia_matrix(body.inertia) + body.mass * (
            center @ center * np.eye(3) - np.outer(center, center))
        if joint.type not in (REVOLUTE, PRISMATIC, UNIVERSAL, SPHERICAL):
            raise NotAdapted(f'{joint.name}: a joint {joint.type}')
        axes = [np.eye(3)] if joint.type == SPHERICAL else [
            np.array([axis]).T for axis in (joint.axis, joint.second_axis) if axis]
        for number, axis in enumerate(axes):
            begin = sum(len(link.rates) for link in self._links)
            about, along = thin(axis), ca.SX(*axis.shape)
            if joint.type == SPHERICAL:
                own = _turned_by(q[first:first + 4])
            elif joint.type == PRISMATIC:
                about, along, own = along, about, ca.SX.eye(3)
                position = thin(position + times(turn, along) * q[first])
            else:
                # About the axis, by cosine and sine.
                fixed, count = axis @ axis.T, len(self.angles)
                own = thin(fixed + self._cosines[count] * thin(np.eye(3) - fixed)
                           + self._sines[count] * hat(thin(axis)))
                self.angles.append(first + number)
            # Between the axes of a joint there is no mass.
            here = 1.0 if number == len(axes) - 1 else 0.0
            parent = Link(parent, list(range(begin, begin + axis.shape[1])), times(turn, own),
                          position, about, along, ca.SX(here * body.mass),
                          thin(here * body.mass * center), thin(here * inertia))
            self._links.append(parent)
            turn, position = ca.SX.eye(3), nothing[:, 0]
        return parent

    def _closed(self, mechanism, planar, last, rest):
        """Yield the rows of loops: of the Jacobian, and the acceleration at qdd = 0."""
        for cut in mechanism.cut_joints:
            if cut.type not in (REVOLUTE, SPHERICAL):
                raise NotAdapted(f'{cut.name}: a cut joint {cut.type}')
            a, b = (_motion(last[body], thin(np.array(point)), rest, self._sines.numel())
                    for body, point in ((cut.body_a, cut.point_a), (cut.body_b, cut.point_b)))
            yield from _between(np.eye(3), ca.SX(3, 3), a, b, 'moves', 'pulled')
            if cut.type == REVOLUTE and not planar:
                axis = cut.axis_a
                if cut.body_a == GROUND:
                    a, b, axis = b, a, cut.axis_b
                # Two directions that turn with a body.
                across = times(a['pose'], thin(np.linalg.svd(np.array([axis]))[2][1:].T))
                turning = times(hat(a['spin']), across)
                yield from _between(across, turning, a, b, 'turns', 'turning')

    def _accelerated(self, tau, rows, biases):
        """Return the solution of the whole system, rates from the leaves to the root first."""
        count = tau.numel()
        matrix = ca.SX(count + biases.numel(), count + biases.numel())
        matrix[count:, :count] = rows
        right = ca.vertcat(tau, -biases)
        for link in reversed(self._links):
            right[link.rates] -= link.joint_force(link.torque, link.force)
            momenta = (thin(times(link.inertia, link.about) + times(hat(link.moment), link.along)),
                       thin(link.mass * link.along - times(hat(link.moment), link.about)))
            one = link
            while one is not None:
                matrix[one.rates, link.rates] = one.joint_force(*momenta)
                momenta, one = one.to_parent(*momenta), one.parent
            if link.parent is not None:
                link.add_to_parent()
        order = [*reversed(range(count)), *range(count, right.numel())]
        return ca.vertcat(*_solved(matrix[order, order], right[order]))[order[:count]]


def _turned_by(quaternion):
    x, y, z, w = ca.vertsplit(quaternion)
    vector = ca.vertcat(x, y, z)
    return ca.SX.eye(3) + 2.0 * times(hat(vector), w * ca.SX.eye(3) + hat(vector))


def _motion(link, point, rest, count):
    """Return how a body and a point of it move: Jacobians, accelerations without gravity, pose."""
    found = {'turns': ca.SX(3, count), 'moves': ca.SX(3, count), 'spin': ca.SX(3, 1),
             'turning': ca.SX(3, 1), 'pulled': ca.SX(3, 1)}
    if link is not None:
        where = link.place + times(link.pose, point)
        found.update(pose=link.pose, spin=times(link.pose, link.spin),
                     turning=times(link.pose, link.turning), pulled=thin(times(
                         link.pose, thin(link.pulled + times(link.bend, point))) - rest))
    while link is not None:
        turns = found['turns'][:, link.rates] = times(link.pose, link.about)
        found['moves'][:, link.rates] = thin(
            times(hat(link.place - where), turns) + times(link.pose, link.along))
        link = link.parent
    return found


def _between(directions, turning, a, b, jacobian, acceleration):
    """Yield rows that keep two motions together along directions and their rates, shape (3, n)."""
    columns, value, spin = (thin(a[key] - b[key]) for key in (jacobian, acceleration, 'spin'))
    for k in range(directions.shape[1]):
        across = thin(directions[:, k]).T
        row = times(across, columns)
        if row.nnz():
            yield row, times(across, value) + times(turning[:, k].T, spin)


def _solved(matrix, right):
    """Solve a symmetric system, given by its lower triangle, in its order and without pivoting."""
    entries = {(i, k): matrix[i, k] for i, k in zip(*matrix.sparsity().get_triplet()) if i >= k}
    solution, inverse, below = ca.vertsplit(right), [], []
    for k in range(len(solution)):
        inverse.append(1.0 / entries[k, k])
        column = {i: entries[i, k] for i in range(k + 1, len(solution)) if (i, k) in entries}
        below.append({i: value * inverse[k] for i, value in column.items()})
        for i, value in below[k].items():
            for j in column:
                if j <= i:
                    entries[i, j] = entries.get((i, j), 0.0) - value * column[j]
            solution[i] -= value * solution[k]
    for k in reversed(range(len(solution))):
        solution[k] *= inverse[k]
        for i, value in below[k].items():
            solution[k] -= value * solution[i]
    return solution


def operations(machine):
    """Return how many operations of each kind an evaluation takes, an fma as two."""
    function = System(machine).function
    counts = Counter(OPERATIONS.get(function.instruction_id(k))
                     for k in range(function.n_instructions()))
    del counts[None]
    return dict(counts)


class Engine:
    """
    Generated code of one machine.

    Parameters
    ----------
    machine : peer_cases.Machine

    Raises
    ------
    CannotExpress, NotAdapted
        Also without gcc.

    """

    name, version, agreed, limit = NAME, ca.__version__, 1e-9, None

    def __init__(self, machine):
        system, generator = System(machine), ca.CodeGenerator('accelerate')
        generator.add(system.function)
        width = -(-len(system.angles) // LANES) * LANES
        text = generator.dump() + LOOP.format(
            places=', '.join(map(str, system.angles)), lanes=width, angles=len(system.angles),
            freedoms=machine.mechanism.coordinates.nv)
        self._built = {name: _compiled(text, options) for name, options in BUILDS.items()}
        first, *others = (lambda *state, name=name: self._call(name, state, 1) for name in BUILDS)
        self.acceleration, self.others = first, dict(zip(list(BUILDS)[1:], others))

    def timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations}."""
        return {name: lambda count, name=name: self._call(name, (q, qd, tau), count)
                for name in BUILDS}

    def _call(self, name, state, count):
        state = [np.array(one, dtype=float) for one in state]
        result = np.zeros(len(state[1]))
        self._built[name](*(one.ctypes.data_as(ctypes.c_void_p) for one in (*state, result)),
                          ctypes.c_long(count), ctypes.c_double(0.0))
        return result

    def lines(self, case, plan):
        """Return no motions: it only evaluates."""
        return []


def _compiled(text, options):
    """Return the loop of a text in C, compiled."""
    with tempfile.TemporaryDirectory() as directory:
        source, library = (Path(directory) / name for name in ('code.c', 'code.so'))
        source.write_text(text)
        run_compiler('CC', 'gcc', [source, '-o', library, *options, '-march=native', '-shared',
                                   '-fPIC', '-lmvec', '-lm'])
        return ctypes.CDLL(str(library)).evaluate_again
