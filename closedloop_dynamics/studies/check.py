# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Contents of a mechanism or a scene as read, in plain text."""

from dataclasses import asdict
from textwrap import indent

from ..effects.registry import effect_type
from ..formats.building import lines
from ..kinematics.assembly import Assembler, MOST_EQUATIONS
from ..kinematics.geometry import Geometry
from ..kinematics.global_assembly import ClosureProblem, find_closed
from ..kinematics.modeling import extent
from ..kinematics.redundancy import find_redundancy
from ..kinematics.second_order import count_forbidden, find_degrees_of_freedom
from ..mechanism.decomposition import decompose
from ..mechanism.digits import digit_notes
from ..mechanism.fields import FieldError
from ..mechanism.mechanism import CUT_JOINT_EQUATIONS, Mechanism, MechanismError
from ..mechanism.reader import with_cuts
from ..scene.integrators import ADAPTIVE, AUTO, BAUMGARTE, INTEGRATORS, STABILISATIONS
from ..scene.model_scene import assembled
from ..scene.tree_choice import count_operations
from ..visual.tables import text_table

# Numbers of a table or curve that are written one by one.
MOST_LISTED = 12


def describe(scene_or_mechanism, simulation=None):
    """
    Describe a Scene or a Mechanism in paragraphs, as ``closedloop check`` prints them.

    With a simulation of the scene, at its start, that is shown beside what the scene says.
    """
    if isinstance(scene_or_mechanism, Mechanism):
        notes = digit_notes(scene_or_mechanism)
        return '\n\n'.join([*_mechanism(scene_or_mechanism), *[_notes(notes)] * bool(notes)])
    return '\n\n'.join(_scene(scene_or_mechanism, simulation))


def describe_model(imported):
    """
    Describe a model in another format, an ``Imported``: mechanism, and how its loops close.

    Returns the description, and whether they close.
    """
    drawn = imported
    imported, found, notes = assembled(imported)
    mechanism = imported.mechanism
    text = '\n\n'.join([
        *_mechanism(mechanism, found=found), *_loops(drawn, found),
        _notes([*notes, *(digit_notes(mechanism) if found.closed else mechanism.rounded),
                *lines(imported, extent(mechanism))])])
    return text, found.closed


def _notes(notes):
    return '\n'.join(['Notes', *(f'  {note}' for note in notes)])


def _loops(imported, found):
    """Return how far the loops are open as drawn and closed, and where the joints are then."""
    mechanism = imported.mechanism
    loops = ClosureProblem(mechanism, extent(mechanism))
    drawn = loops.start(imported.position)
    before = loops.closure_errors(drawn)
    return [
        _table('Loops', ('name', 'open as drawn [m, rad]', 'open when closed'), [
            (name, _value(before[name]), f'{error:.2g}')
            for name, error in found.closure_errors.items()]),
        _table('Joints when closed', ('name', 'type', 'position [rad, m; x, y, z, w]'), [
            (joint.name, joint.type, ', '.join(map(_value, found.q[
                mechanism.coordinates.coordinates[joint.name]].tolist())))
            for joint in mechanism.joints])]


def _scene(scene, simulation):
    return [
        _heading('Scene', scene),
        *_parameters(scene),
        *_mechanism(scene.mechanism, simulation, parameters=False, start=scene.initial.position),
        _initial(scene.mechanism, scene.initial, simulation),
        _effects(scene),
        _method(scene.method),
    ]


def _parameters(described):
    """Return the table of parameters where there are any."""
    if not described.parameters:
        return []
    return [_table('Parameters', ('name', 'value'), [
        (name, _value(value)) for name, value in described.parameters.items()])]


def _mechanism(mechanism, simulation=None, parameters=True, found=None, start=None):
    decomposition = decompose(mechanism)
    parts = [
        _heading('Mechanism', mechanism),
        *(_parameters(mechanism) if parameters else []),
        _table('Bodies', ('name', 'mass [kg]', 'centre of mass [m]', 'inertia [kg m^2]'), [
            (body.name, _value(body.mass), _value(body.center_of_mass), _value(body.inertia))
            for body in mechanism.bodies]),
        _joints(mechanism),
        _table('Subsystems', ('number', 'joints'), [
            (str(number), ', '.join(joints))
            for number, joints in enumerate(decomposition.subsystems, 1)]),
        _cut_joints(mechanism, decomposition),
        *_couplings(mechanism),
    ]
    if mechanism.points:
        parts.append(_table('Points', ('name', 'body', 'position [m]'), [
            (point.name, point.body, _value(point.position)) for point in mechanism.points]))
    if found is None and simulation is None and not mechanism.planar:
        found = _closed(mechanism)
    parts += [*_chosen(mechanism), *_repeated(mechanism, simulation, found)]
    return [*parts, _summary(mechanism, decomposition, simulation, found, start)]


def _joints(mechanism):
    if not mechanism.planar:
        return _spatial_joints(mechanism)
    header = ('name', 'type', 'parent', 'child', 'position [m]', 'angle [rad]', 'actuated')
    return _table('Joints', header, [
        (joint.name, joint.type, joint.parent, joint.child, _value(joint.position),
         _value(joint.angle), 'yes' if joint.actuated else 'no')
        for joint in mechanism.joints])


def _spatial_joints(mechanism):
    header = ('name', 'type', 'parent', 'child', 'position [m]', 'orientation [x, y, z, w]',
              'axis', 'second axis', 'lead [m/rad]', 'actuated')
    return _table('Joints', header, [
        (joint.name, joint.type, joint.parent, joint.child, _value(joint.position),
         _value(joint.orientation), *(
             '-' if value is None else _value(value)
             for value in (joint.axis, joint.second_axis, joint.lead)),
         'yes' if joint.actuated else 'no')
        for joint in mechanism.joints])


def _equations(mechanism):
    """Return how many equations of each cut joint and coupling do not always hold."""
    if mechanism.planar:
        return [*(CUT_JOINT_EQUATIONS[cut.type] for cut in mechanism.cut_joints),
                *(1 for _ in mechanism.couplings)]
    return Geometry(mechanism).equations.counts


def _couplings(mechanism):
    """Return the table of couplings where there are any."""
    return [_table('Couplings', ('name', 'factors of joints', 'sum', 'radius [m]'), [
        (coupling.name, ', '.join(f'{joint} {_value(factor)}'
                                  for joint, factor in coupling.joints.items()),
         _value(coupling.offset) + (f' + f({coupling.law.joint})' if coupling.law else ''),
         '-' if coupling.radius is None else _value(coupling.radius))
        for coupling in mechanism.couplings])] * bool(mechanism.couplings)


def _cut_joints(mechanism, decomposition):
    header = ('name', 'type', 'body A', 'point A [m]', 'body B', 'point B [m]', 'equations',
              'subsystems')
    return _table('Cut joints', header, [
        (cut.name, cut.type, cut.body_a, _value(cut.point_a), cut.body_b, _value(cut.point_b),
         str(count), ', '.join(str(k + 1) for k in subsystems))
        for cut, count, subsystems in zip(
            mechanism.cut_joints, _equations(mechanism), decomposition.cut_subsystems)])


def _chosen(mechanism):
    """Return the choice of cut joints where a description leaves the tree open."""
    tree = mechanism.tree
    if tree is None:
        return []
    items = [('cut', ', '.join(tree.cut) or 'none'),
             ('in the tree', ', '.join(joint.name for joint in mechanism.joints))]
    count = count_operations(mechanism)
    if count is not None:
        text = f'{count} an evaluation'
        if set(tree.listed) != set(tree.cut):
            try:
                listed = count_operations(with_cuts(mechanism, tree.listed))
                text += (f'; {listed} with {", ".join(tree.listed)} cut, as the joints are '
                         f'listed: {1.0 - count / listed:.0%} saved')
            except (FieldError, MechanismError):
                text += '; the order in which the joints are listed gives no tree'
        items.append(('operations', text))
    return [_lines('Tree, chosen by the program', items)]


def _repeated(mechanism, simulation, found):
    """Return equations that repeat others, if any, and the forces they share."""
    if not mechanism.closures or mechanism.planar and (
            simulation is None or mechanism.number_of_equations > MOST_EQUATIONS):
        return []
    if simulation is None and not found.closed:
        return []
    redundancy = find_redundancy(mechanism, found.q if simulation is None else simulation.position)
    if not redundancy.repeated:
        return []
    return [_table('Equations that repeat others', ('of', 'equation', 'repeats others'),
                   redundancy.repeated),
            _table('Forces that are not unique, of which the least are reported',
                   ('in', 'components, in world axes'),
                   [(name, ', '.join(redundancy.components.get(name, ())))
                    for name in redundancy.shared])]


def _summary(mechanism, decomposition, simulation, found, start):
    order = ', '.join(decomposition.elimination_order) or 'none'
    return _lines('Summary', (
        ('constraint equations', _number_of_equations(mechanism)),
        ('degrees of freedom', _degrees_of_freedom(mechanism, simulation, found, start)),
        *_idle(mechanism, simulation, found),
        ('elimination order', f'{order}; blocks of fill: {decomposition.fill}'),
        ('actuated joints', ', '.join(mechanism.actuated_joints) or 'none'),
    ))


def _number_of_equations(mechanism):
    """Return the number of equations; in space apart from those that always hold."""
    left = sum(_equations(mechanism))
    if mechanism.planar:
        return left
    always = mechanism.number_of_equations - left
    return f'{left}, beside {always} that always hold' if always else left


def _idle(mechanism, simulation, found):
    """Return the line of degrees of freedom that move one body about itself and nothing else."""
    if mechanism.planar or not mechanism.closures or simulation is None and not found.closed:
        return []
    position = found.q if simulation is None else simulation.position
    names = ClosureProblem(mechanism, extent(mechanism)).idle(position)
    turns = 'turns' if len(names) == 1 else 'turn'
    return [('idle rotations', f'{len(names)} of these: {", ".join(names)} {turns} about '
             'the line through the joints and nothing else moves')] * bool(names)


def _degrees_of_freedom(mechanism, simulation, found, start):
    joints = mechanism.coordinates.nv
    equations = sum(_equations(mechanism))
    if simulation is None and start is not None and not Assembler(
            mechanism, Geometry(mechanism).equations).closes(start):
        return (f'not known: the loops do not close next to the start ({joints} joints, '
                f'{equations} equations)')
    forbidden = 0
    if simulation is not None:
        freedoms = simulation.data.degrees_of_freedom()
        forbidden = simulation.data.second_order.count if simulation.data.second_order else 0
    elif mechanism.planar:
        freedoms = find_degrees_of_freedom(mechanism)
    elif found.closed:
        forbidden = count_forbidden(mechanism, found.q)
        freedoms = joints - forbidden - (
            ClosureProblem(mechanism, extent(mechanism)).rank(found.q))
    else:
        freedoms = None
    if freedoms is None:
        return (f'not known: no position that closes the loops was found ({joints} joints, '
                f'{equations} equations)')
    # Motions that the loops or one another determine already are refused.
    motions = 0 if simulation is None else len(simulation.mechanism.motions)
    independent = joints - freedoms - motions - forbidden
    several = 'joints' if joints == len(mechanism.joints) else 'of the joints'
    return f'{freedoms} = {joints} {several} - {independent} ' + (
        'equations' if independent == equations else
        f'independent equations ({equations - independent} of {equations} repeat others)') + (
        f' - {motions} prescribed motion{"s" * (motions > 1)}' * bool(motions)) + (
        f' - {forbidden} that loops forbid to second order only' * bool(forbidden))


def _closed(mechanism):
    """Search a position of a mechanism in space that closes the loops."""
    size = extent(mechanism)
    return find_closed(mechanism, size, ClosureProblem(mechanism, size).start())


def _initial(mechanism, initial, simulation):
    """Return the start as it is given and, where there is a simulation, as it was closed."""
    header = ('name', 'position [rad, m]', 'velocity [rad/s, m/s]', 'assembly')
    names = mechanism.coordinates
    states = [(initial.position, initial.velocity, _value)]
    if simulation is not None:
        states.append((simulation.position, simulation.velocity, '{:.6g}'.format))
    rows = []
    for key in names.keys:
        joint = names.joint_of(key)
        row = [key]
        for position, velocity, write in states:
            for quantity, values in (('position', position), ('velocity', velocity)):
                row.append(_written(names.by_name(quantity, values)[key], write))
        row.insert(3, 'held' if {key, joint} & set(initial.hold) else 'free')
        rows.append(tuple(row))
    if simulation is None:
        return _table('Joints at the start, before the loops are closed', header, rows)
    return _table('Joints at the start, as given and with the loops closed',
                  (*header, 'closed position', 'closed velocity'), rows)


def _written(value, write):
    """Return the number of a joint, or its vectors and its quaternion, in words."""
    if not hasattr(value, 'items'):
        return write(value)
    parts = []
    for key, numbers in value.items():
        for one in ([numbers['quaternion']] if key == 'orientation' else [numbers]):
            parts.append(f'{key} [{", ".join(map(write, one))}]')
    return ', '.join(parts)


def _effects(scene):
    return _table('Effects', ('name', 'type', 'parameters'), [
        (name, effect_type(effect) + (', switched off' if name in scene.switched_off else ''),
         ', '.join(f'{key} = {_listed(value)}' for key, value in asdict(effect).items()
                   if value is not None))
        for name, effect in scene.effects.items()])


def _listed(value):
    """Write a value, of a long list its ends."""
    if isinstance(value, tuple) and len(value) > MOST_LISTED:
        return f'{len(value)} from {_value(value[0])} to {_value(value[-1])}'
    return _value(value)


def _method(method):
    items = [
        ('integrator', method.integrator),
        *_setting(method),
        ('stabilisation', method.stabilisation),
    ]
    if STABILISATIONS[method.stabilisation] == BAUMGARTE:
        items.append(('time constant', f'{_value(method.time_constant)} s'))
    return _lines('Method', items)


def _setting(method):
    """Return the integrator's setting: an accuracy, a tolerance or a step size."""
    step = ('step size', f'{_value(method.step_size)} s')
    if method.integrator == AUTO:
        kept = [('accuracy', f'{_value(method.accuracy)} rad or m within a second'), step]
        return kept if method.budget is None else [
            *kept, ('budget', f'{_value(method.budget)} of real time')]
    if INTEGRATORS[method.integrator].kind == ADAPTIVE:
        return [('tolerance', _value(method.tolerance)), step]
    return [step]


def _heading(kind, named):
    lines = [f'{kind} {named.name}']
    if named.description:
        lines.append(f'  {named.description.strip()}')
    return '\n'.join(lines)


def _lines(title, items):
    """Return a title and one line ``key  value`` for each item."""
    width = max(len(key) for key, _ in items)
    return '\n'.join([title, *(f'  {key:{width}}  {value}' for key, value in items)])


def _table(title, header, rows):
    """Return a title with the number of rows, and left-aligned columns."""
    title = f'{title}: {len(rows) or "none"}'
    if not rows:
        return title
    return f'{title}\n' + indent(text_table(header, rows), '  ')


def _value(value):
    """Write a number to 6 digits, a vector in brackets, anything else as it is."""
    if isinstance(value, float):
        return f'{value:.6g}'
    if isinstance(value, tuple):
        return f'[{", ".join(map(_value, value))}]'
    return str(value)
