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
from dataclasses import dataclass, field
from pathlib import Path
import tempfile

import casadi as ca
import numpy as np
from peer_cases import NotAdapted, random_states, run_compiler

from closedloop_dynamics.formats.in_space import in_space  # noqa: I100
from closedloop_dynamics.mechanism.inertia import inertia_matrix
from closedloop_dynamics.mechanism.mechanism import (
    FREE, GROUND, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL)
from closedloop_dynamics.mechanism.rotations import of_quaternion

NAME = 'KKT system by CasADi'
# What the code is compiled with; so declared, gcc computes sines in vectors.
VECTORS = '-DVECTOR=__attribute__((simd("notinbranch")))', '-fno-math-errno'
BUILDS = {f'gcc {level}, sines {kind}': (level, *sines) for level in ('-O3', '-Ofast')
          for kind, sines in (('of libm', ('-DVECTOR=',)), ('in vectors', VECTORS))}
LANES = 4
# Of a Jacobian, relative: pivots below are those of equations that repeat others.
REPEATED = 1e-9
# Of the largest entry of its row: a pivot that fills in less may be so small.
PIVOT = 0.1
# Code that gcc takes longer to compile than so is left out [s].
LONGEST_COMPILING = 120
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


def symmetric(matrix):
    """Return a symmetric matrix of which nothing is computed twice."""
    return ca.tril2symm(ca.tril(thin(matrix)))


@dataclass(eq=False)
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
    carried : SX, shape (6, 6)
        Inertia about its origin that is not one of a rigid body; angular coordinates first.

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
    carried: ca.SX = field(default_factory=lambda: ca.SX(6, 6))

    def move(self, qd, rest):
        """Compute velocity and acceleration at ``qdd`` = 0; ``rest``: of the ground."""
        back, own = thin(self.turn.T), times(self.about, qd[self.rates])
        self.spin, carried, turning, pulled = own, ca.SX(3, 1), ca.SX(3, 1), rest
        if self.parent is not None:
            carried = times(back, self.parent.spin)
            self.spin = thin(carried + own)
            turning = thin(times(back, self.parent.turning) + times(hat(carried), own))
            pulled = self.parent.pulled + times(self.parent.bend, self.position)
        sliding = times(hat(carried), self.along, qd[self.rates])
        self.turning, self.pulled = turning, thin(times(back, pulled) + 2.0 * sliding)
        # What a point of the body is accelerated by more than its origin, over its place.
        self.bend = thin(hat(turning) + times(hat(self.spin), hat(self.spin)))
        self.force = thin(self.mass * self.pulled + times(self.bend, self.moment))
        self.torque = thin(times(self.inertia, turning) + times(hat(self.moment), self.pulled)
                           + times(hat(self.spin), self.inertia, self.spin))

    def momenta(self):
        """Return angular and linear momentum by rate, of all that it carries."""
        both = times(self.carried, ca.vertcat(self.about, self.along))
        return (thin(times(self.inertia, self.about) + times(hat(self.moment), self.along)
                     + both[:3, :]),
                thin(self.mass * self.along - times(hat(self.moment), self.about) + both[3:, :]))

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
        parent.inertia = symmetric(whole)
        parent.moment = thin(parent.moment + moment + self.mass * self.position)
        parent.mass = parent.mass + self.mass
        half = self.carried
        for _ in range(2):
            half = ca.vertcat(*self.to_parent(half[:3, :], half[3:, :])).T
        parent.carried = symmetric(parent.carried + half)


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
    links : list of Link
        Each before those that it carries.
    loops : list of set of Link
        What moves in each loop.
    pivots : list of (int, int)
        Rows of the Jacobian of loops and rates that they are solved for, one after the other, at
        the start; other rows repeat these.

    Raises
    ------
    CannotExpress, NotAdapted
        Where the machine has parts that are not known here.

    """

    def __init__(self, machine):
        mechanism, self.links, self.angles, self.loops = in_space(machine.mechanism), [], [], []
        machine.require_gravity_alone()
        if mechanism.couplings or not mechanism.cut_joints:
            raise NotAdapted('couplings of joints, or no loops')
        names = mechanism.coordinates
        symbols = [ca.SX.sym(*one) for one in (
            ('q', names.nq), ('qd', names.nv), ('tau', names.nv), ('c', names.nv),
            ('s', names.nv))]
        q, qd, tau, self._cosines, self._sines = symbols
        # Of rates: those of a free body along its own axes.
        self._own_axes, rest = ca.SX.eye(names.nv), thin(-ca.SX(machine.gravity))
        last, bodies = {GROUND: None}, {body.name: body for body in mechanism.bodies}
        for joint in mechanism.joints:
            last[joint.child] = self._linked(joint, bodies[joint.child], last[joint.parent], q,
                                             names.coordinates[joint.name].start)
        for link in self.links:
            link.move(times(self._own_axes, qd), rest)
        rows, biases = (ca.vertcat(*parts) for parts in zip(*self._closed(
            mechanism, machine.mechanism.planar, last, rest)))
        state, turns = random_states(machine.scene, 1)[0], np.zeros((2, names.nv))
        angles = state[0][self.angles]
        turns[:, :len(angles)] = np.cos(angles), np.sin(angles)
        self.pivots = _pivots(np.array(ca.Function('rows', symbols, [rows])(*state, *turns)))
        self.function = ca.Function('accelerate', symbols, ca.cse([times(
            self._own_axes.T, self.accelerated(times(self._own_axes, tau), rows, biases))]))

    def _linked(self, joint, body, parent, q, first):
        """Return the last link of a joint, made of as many as it has axes."""
        turn = of_quaternion(joint.orientation)
        turn = thin(np.where(np.abs(turn - np.round(turn)) < 1e-14, np.round(turn), turn))
        position, nothing = thin(np.array(joint.position)), ca.SX(3, 3)
        center = np.array(body.center_of_mass)
        inertia = inertia_matrix(body.inertia) + body.mass * (
            center @ center * np.eye(3) - np.outer(center, center))
        if joint.type not in (REVOLUTE, PRISMATIC, UNIVERSAL, SPHERICAL, FREE):
            raise NotAdapted(f'{joint.name}: a joint {joint.type}')
        axes = [np.eye(3)] if joint.type in (SPHERICAL, FREE) else [
            np.array([axis]).T for axis in (joint.axis, joint.second_axis) if axis]
        for number, axis in enumerate(axes):
            begin = sum(len(link.rates) for link in self.links)
            about, along = thin(axis), ca.SX(*axis.shape)
            if joint.type == SPHERICAL:
                own = _turned_by(q[first:first + 4])
            elif joint.type == FREE:
                own = _turned_by(q[first + 3:first + 7])
                self._own_axes[begin:begin + 3, begin:begin + 3] = own.T
                about, along = ca.horzcat(along, about), ca.horzcat(about, along)
                position = thin(position + times(turn, q[first:first + 3]))
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
            parent = Link(parent, list(range(begin, begin + about.shape[1])), times(turn, own),
                          position, about, along, ca.SX(here * body.mass),
                          thin(here * body.mass * center), thin(here * inertia))
            self.links.append(parent)
            turn, position = ca.SX.eye(3), nothing[:, 0]
        return parent

    def _closed(self, mechanism, planar, last, rest):
        """Yield the rows of loops: of the Jacobian, and the acceleration at qdd = 0."""
        for cut in mechanism.cut_joints:
            if cut.type not in (REVOLUTE, SPHERICAL):
                raise NotAdapted(f'{cut.name}: a cut joint {cut.type}')
            # From the body on that carries both.
            branches = [_carriers(last[body]) for body in (cut.body_a, cut.body_b)]
            while all(branches) and branches[0][0] is branches[1][0]:
                branches = [branch[1:] for branch in branches]
            self.loops.append({link for branch in branches for link in branch})
            a, b = (_motion(branch, last[body], thin(np.array(point)), rest, self._sines.numel())
                    for branch, body, point in zip(branches, (cut.body_a, cut.body_b),
                                                   (cut.point_a, cut.point_b)))
            yield from _between(np.eye(3), ca.SX(3, 3), a, b, 'moves', 'pulled')
            if cut.type == REVOLUTE and not planar:
                axis = cut.axis_a
                if cut.body_a == GROUND:
                    a, b, axis = b, a, cut.axis_b
                # Two directions that turn with a body.
                across = times(a['pose'], thin(np.linalg.svd(np.array([axis]))[2][1:].T))
                turning = times(hat(a['spin']), across)
                yield from _between(across, turning, a, b, 'turns', 'turning')

    def composed(self, links, tau):
        """
        Compose the inertias of links that carry one another, from the leaves on.

        Returns the inertia matrix, what drives it, and the momenta by rate at what carries all of
        them; which then carries their inertias and forces, too.
        """
        count = tau.numel()
        matrix, driven, at_carrier = ca.SX(count, count), ca.SX(tau), ca.SX(6, count)
        for link in reversed(links):
            driven[link.rates] -= link.joint_force(link.torque, link.force)
            momenta, one = link.momenta(), link
            while one in links:
                matrix[one.rates, link.rates] = one.joint_force(*momenta)
                momenta, one = one.to_parent(*momenta), one.parent
            at_carrier[:, link.rates] = ca.vertcat(*momenta)
            if link.parent is not None:
                link.add_to_parent()
        return ca.triu2symm(ca.triu(matrix)), driven, at_carrier

    def accelerated(self, tau, rows, biases):
        """Return the solution of the whole system, rates from the leaves to the root."""
        kept, count = [row for row, _ in self.pivots], tau.numel()
        matrix, driven, _ = self.composed(self.links, tau)
        matrix = ca.blockcat([[matrix, rows[kept, :].T],
                              [rows[kept, :], ca.SX(len(kept), len(kept))]])
        right, order = ca.vertcat(driven, -biases[kept]), []
        for links in reversed(self.clusters()):
            # Loops after their own joints: what carries them is not filled in more than by these.
            rates = [rate for link in links for rate in link.rates]
            order += [*reversed(rates), *(count + number for number, (_, column) in enumerate(
                self.pivots) if column in rates)]
        found = substituted(*eliminated(
            matrix[order, order], right[order]))
        return ca.vertcat(*(found[order.index(k)] for k in range(count)))

    def clusters(self):
        """Return lists of links whose joints loops connect, each after what carries it."""
        found = [{link} for link in self.links]
        for loop in self.loops:
            found = [*(one for one in found if not one & loop),
                     loop.union(*(one for one in found if one & loop))]
        return sorted(([link for link in self.links if link in one] for one in found),
                      key=lambda links: self.links.index(links[0]))


def _pivots(jacobian):
    """Return rows and columns that eliminate one another with little fill-in; see ``System``."""
    left, limit, found = jacobian.copy(), REPEATED * np.abs(jacobian).max(), []
    while True:
        large = np.abs(left)
        large[large <= limit] = 0.0
        there = large > 0.0
        filled_in = np.outer(there.sum(1) - 1, there.sum(0) - 1)
        able = there & (large >= PIVOT * large.max(1, keepdims=True))
        if not able.any():
            return found
        # Of the cheapest ones the largest.
        cheap = able & (filled_in == filled_in[able].min())
        row, column = np.unravel_index(np.argmax(np.where(cheap, large, 0.0)), left.shape)
        found.append((int(row), int(column)))
        left -= np.outer(left[:, column] / left[row, column], left[row])
        left[row], left[:, column] = 0.0, 0.0


def _carriers(link):
    """Return a link and all that carry it, from the ground on."""
    return [] if link is None else [*_carriers(link.parent), link]


def _turned_by(quaternion):
    x, y, z, w = ca.vertsplit(quaternion)
    vector = ca.vertcat(x, y, z)
    return ca.SX.eye(3) + 2.0 * times(hat(vector), w * ca.SX.eye(3) + hat(vector))


def _motion(branch, link, point, rest, count):
    """
    Return how a body and a point of it move: Jacobians, accelerations at qdd = 0, pose.

    By the links of a branch alone, in the frame of what carries it.
    """
    pose, place, poses = ca.SX.eye(3), ca.SX(3, 1), []
    for one in branch:
        place, pose = thin(place + times(pose, one.position)), times(pose, one.turn)
        poses.append((place, pose))
    found = {'turns': ca.SX(3, count), 'moves': ca.SX(3, count), 'spin': ca.SX(3, 1),
             'turning': ca.SX(3, 1), 'pulled': rest, 'pose': pose}
    if link is not None:
        found.update(spin=times(pose, link.spin), turning=times(pose, link.turning),
                     pulled=times(pose, thin(link.pulled + times(link.bend, point))))
    where = thin(place + times(pose, point))
    for one, (place, pose) in zip(branch, poses):
        turns = found['turns'][:, one.rates] = times(pose, one.about)
        found['moves'][:, one.rates] = thin(
            times(hat(place - where), turns) + times(pose, one.along))
    return found


def _between(directions, turning, a, b, jacobian, acceleration):
    """Yield rows that keep two motions together along directions and their rates, shape (3, n)."""
    columns, value, spin = (thin(a[key] - b[key]) for key in (jacobian, acceleration, 'spin'))
    for k in range(directions.shape[1]):
        across = thin(directions[:, k]).T
        row = times(across, columns)
        if row.nnz():
            yield row, times(across, value) + times(turning[:, k].T, spin)


def eliminated(matrix, right):
    """
    Factor a symmetric matrix, given by its lower triangle, in its order and without pivoting.

    Returns inverse pivots, columns of the factor below them, and the right sides, row by row,
    after elimination.
    """
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
    return inverse, below, solution


def substituted(inverse, below, solution):
    """Return the solution, row by row, after ``eliminated``."""
    solution = list(solution)
    for k in reversed(range(len(solution))):
        solution[k] *= inverse[k]
        for i, value in below[k].items():
            solution[k] -= value * solution[i]
    return solution


def operations(machine, system=System):
    """Return how many operations of each kind an evaluation takes, an fma as two."""
    function = system(machine).function
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
    system = System

    def __init__(self, machine):
        system, generator = self.system(machine), ca.CodeGenerator('accelerate')
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
                                   '-fPIC', '-lmvec', '-lm'], LONGEST_COMPILING)
        return ctypes.CDLL(str(library)).evaluate_again
