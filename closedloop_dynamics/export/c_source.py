# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A scene as C99: evaluation, correction of the loops, a step, energies and points."""

from contextlib import suppress
import json
import re
import textwrap

import numpy as np

from .c_cost import Cost, MOST_CORRECTIONS
from .c_template import (
    BLOCKS, CALLED, CASADI, COMPONENTS, COMPONENTS_WITH_QUATERNIONS, COMPUTED_TORQUE, CONTROLLER,
    DECISION, DIFFERENTIATE, FEEDBACK, FORCES, HEADER, INVERSE, JACOBIANS, LINEAR_STEP, LINEARISE,
    MOVING, OPERATIONAL, PLAIN, SOURCE, STRAIGHT, TASKS, TURNING, VELOCITY, WITH_QUATERNIONS,
    WRENCHES)
from ..codegen.arms import AlwaysSingularError
from ..codegen.c_writer import (
    in_single_precision, LIBRARY_SINES, SINE_AND_COSINE, statements, statements_in_lanes, VECTORS)
from ..codegen.derivatives import COLUMN, DerivativeTrace, RATE
from ..codegen.expression_graph import Q, QD
from ..codegen.function_table import (
    BODY, CLOSURE, CORRECTION, CORRECTIONS, CUT_POINT, ENERGY, EVALUATION, GRAVITY, JACOBIAN,
    JOINT_FORCE, LAM, LANES, QDD, SHARED, TAU, VALUE_COLUMNS, VALUES)
from ..codegen.scene_routines import PLACE, PLACE_BIAS, PLACE_RATE, POINT, POWER, SceneTrace
from ..effects.traced_laws import act, powers
from ..engine.types import CUT_NUMBER, CUT_ROW, ROWS
from ..kinematics.modeling import extent
from ..mechanism.errors import SimulationError
from ..simulation.independent import choose_independent
from ..simulation.traced_scene import refusals

# What the columns of the arrays hold: those of ``engine.types`` and ``codegen.space``.
_BODY_COLUMNS = (
    'mass, first moments x y, moment of inertia about the origin, place of the joint in the '
    'parent x y, angle of the frame at coordinate 0, rotor inertia at the joint')
_SPATIAL_BODY_COLUMNS = (
    'mass, first moments x y z, moments of inertia about the origin xx yy zz xy xz yz, place of '
    "the joint in the parent x y z, its axes there row by row, whether it shares the parent's z "
    'axis, rotor inertia at the joint, lead of a screw, angular momentum of rotors on the parent '
    'x y z')
_CUT_COLUMNS = (
    'cut point in body A x y, in body B x y, angle or length; of couplings the sum held, then the '
    'factor of each joint')
# Closure errors in single precision, in roundings of the mechanism's size: what sums along a loop
# leave, and what no regular position has.
ROUNDINGS, MOST_ROUNDINGS = 8.0, 1000.0
_SPATIAL_CUT_COLUMNS = (
    'cut point in body A x y z, in body B x y z, axes in A row by row, in B, length or lead; of '
    'couplings the sum held, then the factor of each joint')


def c_source(simulation, name, derivatives=False, float32=False):
    """
    Write a scene as C99.

    Parameters
    ----------
    simulation : Simulation
        In the state to start from; parameters are those that effects and masses have now.
    name : str
        Of the functions and of both files.
    derivatives : bool
        Whether to write derivatives, too, which take most of the file.
    float32 : bool
        Whether numbers are of single precision, for processors that have no other. Loops are then
        closed to its rounding; CasADi, which has double precision, cannot call the code.

    Returns
    -------
    source, header : str
        What ``name.c`` and ``name.h`` hold.

    Raises
    ------
    ValueError
        For a name that C does not take.
    SimulationError
        Where something of the scene has no C, with names and reasons; or where the scene starts in
        a singular position, where the code cannot begin.

    """
    if not re.fullmatch('[A-Za-z][A-Za-z0-9_]*', name):
        raise ValueError(f'name: expected letters, digits and _, a letter first, got {name!r}')
    require_c(simulation)
    return _Text(simulation, name, derivatives, float32).both()


def c_cost(simulation, derivatives=False, float32=False):
    """Return the ``c_cost.Cost`` of what ``c_source`` writes; it raises the same errors."""
    require_c(simulation)
    text = _Text(simulation, 'model', derivatives, float32)
    text.both()
    return text.cost


def require_c(simulation, language='C', timed=False):
    """
    Refuse a simulation that has no C, or no code in another language of the same graph.

    ``timed``: whether the code is given forces and motions over time from outside.
    """
    reasons = refusals(simulation.data, instant=timed, driven=timed)
    if reasons:
        raise SimulationError(
            f'{simulation.scene.name} cannot be written as {language}: ' + '; '.join(
                f'{what} ({why})' for what, why in reasons.items()))
    system = simulation.data.system
    before = system.work.health.copy()
    good = system.native.is_regular(simulation.position, simulation.velocity)
    system.work.health[:] = before
    if not good:
        # The elimination alone, as in C, cannot evaluate the state.
        raise SimulationError(
            f'{simulation.scene.name} cannot be written as {language}: closure equations depend '
            'on one another where it starts, or nearly, or masses differ so much that the '
            'elimination alone cannot decide. Start it in another position.')


def left_out(simulation):
    """Return names of effects that only measure, and have no part in the motion."""
    return [name for name, record in simulation.data.effect_set.records.items()
            if record.instrument() is not None]


class _Text:
    """Both files of one scene; ``cost`` is that of the functions, once they are written."""

    def __init__(self, simulation, name, derivatives, float32):
        self.simulation, self.name, self.derivatives = simulation, name, derivatives
        self.float32, self.cost = float32, Cost(8 - 4 * float32)
        self.system, self.model = simulation.data.system, simulation.data.system.model
        self.planar, table = simulation.mechanism.planar, self.system.effects
        values = np.zeros((0, VALUE_COLUMNS)) if table is None else table.values
        self.rows, places = simulation.data.loop_model.named_points
        body, cut = ((_BODY_COLUMNS, _CUT_COLUMNS) if self.planar
                     else (_SPATIAL_BODY_COLUMNS, _SPATIAL_CUT_COLUMNS))
        effects = ', '.join(simulation.data.effect_set.by_name)
        # Joints whose wrenches are unique; rows of their children, origins and axes there.
        self.joints, self.carried = simulation.data.force_places()
        # Behind them the cut joints: their rows, and axes of bodies A.
        self.cuts = simulation.data.cut_rows, self._cut_axes()
        if self.joints:
            self.joints += [cut.name for cut in simulation.mechanism.cut_joints]
        # Factors that columns of derivatives have in common; what finds and takes other ones.
        self.solution = {'FACTORS': '0', 'FACTORISE': '0', 'ASIDE': 'solve'}
        # By the input of a routine: the member of the model, its numbers, and their description.
        self.members = {
            BODY: ('body', self.model.body, f'of each row of the tree, the ground first: {body}'),
            GRAVITY: ('gravity', self.model.gravity, 'acceleration of gravity'),
            CUT_POINT: ('cut_point', self.model.cut_point,
                        f'of each closed joint or coupling, in the order of elimination: {cut}'),
            VALUES: ('effect', values, f'of each effect ({effects}) its parameters'),
            POINT: ('point', places, 'of each named point its place in its row of the tree')}
        self.members = {source: one for source, one in self.members.items() if one[1].size}

    def _cut_axes(self):
        """Return the axes of bodies A of the cut joints in the frames of their rows."""
        mechanism = self.simulation.mechanism
        _, _, axes = self.simulation.data.loop_model.joint_places
        turned = {joint.child: own for joint, own in zip(mechanism.joints, axes)}
        return np.array([turned.get(cut.body_a, np.eye(3))
                         for cut in mechanism.cut_joints]).reshape(-1, 3, 3)

    def both(self):
        """Return the source and the header."""
        words, versions = self._words(), '\n'.join(self._versions())
        vectors = re.search(r'\b(four|eight) ', versions + words['ROUTINES'])
        words |= {'VERSIONS': versions, **self.solution, 'COSTS': '',
                  'VECTORS': f'{VECTORS}\n' if vectors else ''}
        free, driven, points = int(words['NI']), int(words['NA']), int(words['NP'])
        # By what they depend on, in an order in which none has one of the later ones.
        for there, parts in (
                (not self.float32, {'CASADI': CASADI, 'CALLED': CALLED, 'BLOCKS': BLOCKS}),
                (free, {'LINEARISE': LINEARISE, 'LINEAR': LINEAR_STEP}),
                (free and (points or free == driven), {'DECISION': DECISION}),
                ('-1' not in words['OWN'], {'FEEDBACK': FEEDBACK, 'CONTROLLER': CONTROLLER}),
                (free and free == driven, {'DECLARED': INVERSE, 'CONTROL': COMPUTED_TORQUE}),
                (free and points, {'MOVING': MOVING, 'VELOCITY': VELOCITY}),
                (points, {'TASKS': TASKS, 'OPERATIONAL': OPERATIONAL}),
                (self.derivatives, {'JACOBIANS': JACOBIANS, 'DIFFERENTIATE': DIFFERENTIATE}),
                (self.joints, {'FORCES': FORCES, 'WRENCHES': WRENCHES})):
            words |= {word: _filled(text, words) if there else ''
                      for word, text in parts.items()}
        source = _filled(SOURCE, words)
        sizes = {key: int(words[key]) for key in ('NQ', 'NV', 'NC', 'NI', 'NA')}
        sizes |= {'SPACE': int(words['SIZE']), 'PLACES': points * int(words['SIZE'])}
        self.cost.read(source, self.name, sizes | {
            'NC1': max(sizes['NC'], 1), 'NI1': max(sizes['NI'], 1), 'BALLS': self._balls()})
        words['COSTS'] = '\n'.join(_wrapped(line) for line in self.cost.lines())
        both = source, _filled(HEADER, words)
        return tuple(map(in_single_precision, both)) if self.float32 else both

    def _words(self):
        """Return the replacement of each word of the templates."""
        simulation, system = self.simulation, self.system
        coordinates, points = simulation.coordinates, simulation.mechanism.points
        nq, nv, nc = len(simulation.position), len(system.qdd), len(system.lam)
        size, tolerance, limit = len(self.model.gravity), *self._tolerances()
        names = coordinates.columns('velocity')
        driven = [simulation.joint_names.index(one) for one in simulation.actuated_joints
                  if one in simulation.joint_names]
        free = choose_independent(simulation.constraint_jacobian, driven)
        return {
            'NI': str(len(free)), 'NA': str(len(driven)), 'MOST': str(MOST_CORRECTIONS),
            'CHOICE': ', '.join(map(str, [*free, -1])),
            # Places of the independent freedoms in q: -1 of rotations.
            'OWN': ', '.join(map(str, np.asarray(coordinates.place)[free])),
            'DRIVES': ', '.join(map(str, [*driven, -1])),
            'INDEPENDENT': _wrapped(', '.join(f'{n} {names[n]}' for n in free) or 'none'),
            'NEWTON': repr(1e-3 if self.float32 else 1e-8),
            'RATIO': '1e5' if self.float32 else '1e8',
            'NAME': self.name, 'UPPER': self.name.upper(), 'HEADER': f'{self.name}.h',
            # No name ends a comment.
            'TITLE': f'{simulation.scene.name}, in C'.replace('*/', '* /'),
            'NQ': str(nq), 'NV': str(nv), 'NC': str(nc), 'NP': str(len(points)),
            'SIZE': str(size),
            'COLUMNS': '\n'.join(_wrapped(f'{name}: {what}.')
                                 for name, _, what in self.members.values()),
            'MEMBERS': '\n'.join(f'  double {name}{_shape(array)};'
                                 for name, array, _ in self.members.values()),
            'JOINTS': _numbered(self.joints), 'NAMED': _strings(self.joints),
            'POSITIONS': _strings(coordinates.columns('position')),
            'VELOCITIES': _strings(coordinates.columns('velocity')),
            'COORDINATES': _numbered(coordinates.columns('position')),
            'RATES': _numbered(names),
            'MULTIPLIERS': '\n'.join(_wrapped(line) for line in self._multipliers()),
            'POINTS': _numbered([point.name for point in points]),
            'DEFAULT': ',\n'.join([*(f'  .{name} = {_initializer(array)}'
                                     for name, array, _ in self.members.values()),
                                   f'  .closure_tolerance = {tolerance!r}',
                                   f'  .closure_limit = {limit!r}']),
            'START': f'  .q = {_initializer(simulation.position)},\n'
                     f'  .qd = {_initializer(simulation.velocity)}',
            'SINES': LIBRARY_SINES if self.float32 else SINE_AND_COSINE,
            'ROUTINES': '\n'.join(self._routines()),
            'MANIFOLD': self._manifold(),
            'SPARSITIES': '\n'.join(_dense(f'column_{name}', count, 1) for name, count in (
                ('nq', nq), ('nv', nv), ('nc', nc))),
            'DENSE': '\n'.join(_dense(name, *shape) for name, shape in (
                ('qdd_q', (nv, nq)), ('qdd_rest', (nv, nv)), ('lam_q', (nc, nq)),
                ('lam_rest', (nc, nv))))}

    def _tolerances(self):
        """Return the closure errors that a correction leaves at most, and at which it gives up."""
        settings = self.system.settings
        tolerance, limit = float(settings.closure_tolerance), float(settings.closure_limit)
        if not self.float32:
            return tolerance, limit
        rounding = float(np.finfo(np.float32).eps) * extent(self.simulation.mechanism)
        return max(tolerance, ROUNDINGS * rounding), max(limit, MOST_ROUNDINGS * rounding)

    def _multipliers(self):
        """Say of which joints the multipliers are."""
        closures = self.simulation.mechanism.closures
        for cut in sorted(self.model.cut.tolist(), key=lambda cut: cut[CUT_ROW]):
            if cut[ROWS]:
                first = cut[CUT_ROW]
                until = '' if cut[ROWS] == 1 else f' to {first + cut[ROWS] - 1}'
                yield f'{first}{until}: {closures[cut[CUT_NUMBER]].name}'

    def _versions(self):
        """Yield the generated functions that take long."""
        yield self._function(
            'int VERSION(evaluation)', self._shortest(EVALUATION),
            {Q: 'const double *q', QD: 'const double *qd', TAU: 'const double *tau',
             QDD: 'double *qdd', LAM: 'double *lam'})
        yield '/* Changes of q and qd that close the loops, one behind the other. */'
        yield self._function(
            'int VERSION(correction)', self._shortest(CORRECTION),
            {Q: 'const double *q', QD: 'const double *qd', CORRECTIONS: 'double *change',
             CLOSURE: 'double *closure'})
        if self.derivatives:
            yield from self._differentiation()

    def _differentiation(self):
        """Yield the functions that compute columns of derivatives, and solve for these."""
        ways = {}
        # In the plane a second solution takes more code, and the first one hardly less time.
        for with_arms in (not (self.planar or self.float32), False):
            if False in ways:
                break
            one = self._trace(DerivativeTrace, with_arms=with_arms)
            with suppress(AlwaysSingularError):
                (columns, shared), (solve,) = one.in_lanes()
                ways[one.by_arms] = columns, solve, int(shared.outputs[0][2])
        self.solution['FACTORS'] = str(max(count for *_, count in ways.values()))
        if True in ways:
            factors, solve, _ = ways[False]
            factors.outputs = [one for one in factors.outputs if one[0] == SHARED]
            factorise, aside = (f'{what}_next_to_singular_arms' for what in ('factorise', 'solve'))
            yield self._function(f'int VERSION({factorise})', factors, {
                Q: 'const double *q', SHARED: 'double *factors'})
            yield self._solver(aside, solve)
            self.solution |= {'FACTORISE': f'BEST({factorise}, (model, q, factors))',
                              'ASIDE': aside}
        columns, solve, _ = ways[True in ways]
        yield self._function('int VERSION(columns_of)', columns, {
            Q: 'const double *q', QD: 'const double *qd', QDD: 'const double *qdd',
            LAM: 'const double *lam', COLUMN: 'double *columns', SHARED: 'double *factors',
            RATE: 'double *rates'})
        yield self._solver('solve', solve)

    def _solver(self, name, routine):
        """Return a function that solves for eight columns side by side."""
        self.cost.count(f'void VERSION({name})', routine, LANES)
        body = '\n  '.join(statements_in_lanes(
            routine, {Q: 'columns', SHARED: 'factors', QD: 'found'}, SHARED))
        return (f'static void VERSION({name})(\n  const double *columns, const double *factors, '
                f'double *found)\n{{\n  {body}\n}}\n')

    def _routines(self):
        """Yield the other generated functions: those specific to the mechanism."""
        unrolled, rows = self._unrolled, self.rows.tolist()
        yield self._function(
            'int energies_of', unrolled(lambda one: one.energies()),
            {Q: 'const double *q', QD: 'const double *qd', ENERGY: 'double *energies'})
        yield self._function(
            'int powers_of', unrolled(self._store_powers),
            {Q: 'const double *q', QD: 'const double *qd', POWER: 'double *powers'})
        yield self._function(
            'int places_of', unrolled(lambda one: one.places(rows), only=PLACE),
            {Q: 'const double *q', PLACE: 'double *places'})
        yield self._function(
            'int velocities_of', unrolled(lambda one: one.places(rows), only=PLACE_RATE),
            {Q: 'const double *q', QD: 'const double *qd', PLACE_RATE: 'double *velocities'})
        yield '/* Accelerations of the points where the joint rates stay as they are. */'
        yield self._function(
            'int biases_of', unrolled(lambda one: one.places(rows), only=PLACE_BIAS),
            {Q: 'const double *q', QD: 'const double *qd', PLACE_BIAS: 'double *biases'})
        yield self._function(
            'int closures_of', unrolled(lambda one: one.closures(), DerivativeTrace),
            {Q: 'const double *q', CLOSURE: 'double *errors', JACOBIAN: 'double *jacobian'})
        if self.joints:
            yield self._function(
                'int joint_forces_of', unrolled(
                    lambda one: one.joint_forces(*self.carried, *self.cuts), DerivativeTrace),
                {Q: 'const double *q', QD: 'const double *qd', QDD: 'const double *qdd',
                 LAM: 'const double *lam', JOINT_FORCE: 'double *forces'})

    def _store_powers(self, trace):
        trace.outputs += [(POWER, place, power) for place, power in enumerate(
            powers(self.system.effects, trace.moved().rates))]

    def _shortest(self, which):
        """Return a routine of the fewest operations; next to singular arms it has another."""
        # What is left of small differences is too little in single precision.
        return (self._trace(SceneTrace) if self.float32 else self._trace(
            SceneTrace, with_arms=True, by=None)).routine(which)

    def _trace(self, kind, **how):
        table = self.system.effects
        return kind(
            self.model, lambda forces: act(table, forces),
            self.members[VALUES][1].shape if VALUES in self.members else (0, VALUE_COLUMNS), **how)

    def _unrolled(self, what, kind=SceneTrace, only=None):
        """Return a routine of a new unrolling, of all outputs or only one."""
        one = self._trace(kind)
        what(one)
        one.outputs = [output for output in one.outputs if only in (None, output[0])]
        return one.named('')

    def _function(self, head, routine, parameters):
        """Return a function of the model and some arrays."""
        places = {source: text.rpartition('*')[2] for source, text in parameters.items()}
        pointers = []
        for source, (name, array, _) in self.members.items():
            pointers.append(f'const double *const {name} = &model->{name}{array.ndim * "[0]"};')
            places[source] = name
        before, otherwise = '', None
        if routine.otherwise is not None:
            other = f'VERSION({routine.otherwise.name})'
            before = self._function(f'int {other}', routine.otherwise, parameters)
            otherwise = f'return {other}(model, {", ".join(map(places.get, parameters))})'
        lines = statements(routine, places, otherwise)
        self.cost.count(head, routine)
        used = '\n'.join(lines)
        unused = [*(f'(void){name};' for name in places.values()
                    if not re.search(rf'\b{name}\[', used)), '(void)model;']
        body = '\n  '.join([*pointers, *unused, *lines])
        return (f'{before}static {head}(\n  const {self.name}_model *model, '
                f'{", ".join(parameters.values())})\n{{\n  {body}\n}}\n')

    def _balls(self):
        return 0 if self.system.manifold is None else len(self.system.manifold.balls)

    def _manifold(self):
        """Return how states are moved, with quaternions where there are any."""
        manifold = self.system.manifold
        components = self.derivatives and not self.float32
        turns = self.derivatives and len(self.system.qdd) > len(self.system.lam)
        if manifold is None:
            return PLAIN + '\n'.join(['', *[COMPONENTS] * components, *[STRAIGHT] * turns])
        return _filled(WITH_QUATERNIONS, {
            'BALLS': str(self._balls()), 'BALL': _initializer(manifold.balls),
            'PLACE': _initializer(manifold.place)}) + '\n'.join([
                '', *[COMPONENTS_WITH_QUATERNIONS] * components, *[TURNING] * turns])


def _wrapped(text):
    """Return a line of a comment, broken where it is long."""
    return textwrap.fill(text, 99, initial_indent=' *   ', subsequent_indent=' *     ')


def _numbered(names):
    """Return names with their places, as lines of a comment."""
    return _wrapped(', '.join(f'{n} {name}' for n, name in enumerate(names)) or 'none')


def _strings(names):
    """Return names as an initializer of a table of strings, ended by 0."""
    return ', '.join([*(json.dumps(name, ensure_ascii=False) for name in names), '0'])


def _shape(array):
    return ''.join(f'[{count}]' for count in array.shape)


def _initializer(array):
    """Return an array as C initializes it, every number to the last bit."""
    if array.ndim > 1:
        return '{' + ',\n    '.join(map(_initializer, array)) + '}'
    # An end stop that is not there is at infinity.
    return '{' + ', '.join(map(repr, array.tolist())).replace('inf', 'HUGE_VAL') + '}'


def _dense(name, rows, columns):
    """Return CasADi's sparsity of a dense matrix: compressed columns."""
    numbers = [rows, columns, *range(0, rows * columns + 1, rows or 1), *columns * [*range(rows)]]
    if rows == 0:
        numbers = [rows, columns, *(columns + 1) * [0]]
    text = textwrap.fill(', '.join(map(str, numbers)), 99, initial_indent='  ',
                         subsequent_indent='  ')
    return f'static const long long int {name}[] = {{\n{text}}};'


def _filled(text, words):
    """Return a template with words in their places."""
    return re.sub('@([A-Z]+)@', lambda match: words[match[1]], text)
