# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Columns, codes and fields are the same in the engine's C++ as in Python."""

from pathlib import Path
import re

from closedloop_dynamics import engine
from closedloop_dynamics.codegen import (
    elimination, equations, function_table, live_scene, refinement, sensitivities,
    space as code_in_space)
from closedloop_dynamics.effects import (
    curve, effect_table, element, expression, force_law, profile, traced_effect)
from closedloop_dynamics.engine import manifold, status, types
from closedloop_dynamics.scene import integrators, tableau
from closedloop_dynamics.simulation import (
    batch, evaluator, guards, recorded_run, run, stepped_run, system)
import pytest

FOLDER = Path(engine.__file__).parent
# Namespace and name of an enum; the module with the same names, and those that differ there.
ENUMS = {
    'tree': (types, {}),
    'tree.Type': (types, {}),
    'work': (types, {}),
    'plane': (types, {}),
    'space': (code_in_space, {}),
    'kernel': (types, {}),
    'kernel.Cut': (types, {}),
    'joint': (types, {}),
    'cut.Column': (types, {'TYPE': 'CUT_TYPE', 'NUMBER': 'CUT_NUMBER'}),
    'cut.Type': (types, {'PRISMATIC': 'CUT_PRISMATIC', 'COUPLING': 'CUT_COUPLING'}),
    'cut.Point': (types, {}),
    'health': (types, {}),
    'routine': (function_table, {}),
    'Responses': (types, {'NONE': 'NO_RESPONSES'}),
    'Stabilisation': (integrators, {}),
    'Status': (status, {}),
    'effect.Column': (element, {}),
    'effect.Role': (force_law, {}),
    'effect.Gap': (force_law, {}),
    'cut_coordinate': (element, {}),
    'law_routine': (function_table, {}),
    'cut_coordinate.Value': (element, {}),
    'profile.cpp: Operation': (expression, {}),
    'manifold.cpp: QUATERNION': (manifold, {}),
    'Outcome': (run, {}),
    'finding': (recorded_run, {'COLUMNS': None}),
    'energy_balance.cpp: OWN': (element, {}),
    'manifold_derivatives.cpp: QUATERNION': (manifold, {}),
    'step_routine': (sensitivities, {}),
    'step_routine.Array': (function_table, {}),
    'part': (equations, {}),
    'axis': (equations, {}),
    'closing': (equations, {}),
}
# The engine's alone.
INNER = {'Manner', 'Level', 'Comparison', 'Factors', 'Outputs', 'projection.cpp: Corrector',
         'rosenbrock.cpp: STAGE', 'python_api.hpp: PyGILState_STATE', 'effect.Equation',
         'nearby', 'scratch', 'independent.cpp: CHOSEN_RATIO', 'left_out', 'Checked',
         'contact', 'contact.Node', 'contact.Trial', 'contact.Search', 'present'}
# Constants of the same name.
CONSTANTS = {
    'batch.hpp': (function_table, ('LANES',)),
    'places.hpp': (function_table, ('PLACES',)),
    'error_control.hpp': (status, ('MOST_EVALUATIONS',)),
    'switching.cpp': (status, ('FLOOR', 'SHARE', 'CLOSER', 'WINDOW', 'LONGEST_PAUSE')),
    'run.cpp': (guards, ('ENERGY_WARN', 'ENERGY_ERROR', 'MOST_EXCHANGES')),
    'elimination.hpp': (elimination, ('POOR_PIVOT',)),
    'elimination.cpp': (elimination, ('SMALL_PIVOT', 'MANY_JOINTS')),
    'refinement.cpp': (refinement, ('REFINEMENTS', 'CONVERGED', 'ROUNDING', 'VERY_MOBILE')),
    'manifold.cpp': (manifold, ('HALF',)),
    'profile.hpp': (profile, ('SAME_TIME', 'COLUMNS')),
    'curve.hpp': (curve, ('COLUMNS',)),
    'laws.hpp': (traced_effect, ('MOST_COORDINATES',)),
    'sensitivity.hpp': (stepped_run, ('SCRATCH_ROWS',)),
    'static_friction.hpp': (live_scene, ('REST',)),
    'model.cpp': (types, ('TREE_COLUMNS', 'BODY_COLUMNS', 'CUT_COLUMNS', 'BODY_KERNELS')),
    'workspace.cpp': (types, ('WORK_COLUMNS', 'COUPLED_WORK_COLUMNS', 'JOINT_COLUMNS',
                              'HEALTH_COLUMNS')),
}
RECORDS = {
    'AccelerationDerivatives': system.AccelerationDerivatives,
    'EffectElement': effect_table.EffectElement, 'Tableau': tableau.Tableau,
    'RunBuffer': recorded_run.RunBuffer, 'GuardLimits': run.GuardLimits,
    'Lane': batch.Lane, 'MethodOptions': run.MethodOptions, 'Request': evaluator.Request,
    'Batch': batch.Batch, 'Loops': equations.Loops, 'Far': equations.Far,
    'SteppedRun': stepped_run.SteppedRun, 'Tape': stepped_run.Tape,
    'StepRoutines': stepped_run.StepRoutines, 'LaneRoutines': stepped_run.LaneRoutines,
    'Chart': stepped_run.Chart, 'StateSteps': stepped_run.StateSteps,
    'RunInputs': stepped_run.RunInputs, 'WideInputs': stepped_run.RunInputs}


def text(path):
    """Return a source without its comments."""
    return re.sub(r' *//.*', '', path.read_text())


def sources():
    """Return the text of the headers and sources of the engine by name."""
    return {path.name: text(path) for path in sorted([*FOLDER.glob('*.hpp'),
                                                      *FOLDER.glob('*.cpp')])}


def values(body, known):
    """Return the enumerators of the text between the braces, by name."""
    found, following = {}, 0
    for entry in filter(None, (part.strip() for part in body.split(','))):
        name, _, given = (part.strip() for part in entry.partition('='))
        if given:
            following = int(given) if given.isdigit() else known[given]
        found[name] = following
        following += 1
    return found


def enums():
    """Return the enumerators of every enum by its name: namespace, file where it has none."""
    found, known = {}, {}
    for name, source in sources().items():
        # Namespaces that begin and end at the margin, none within another, beside the outermost.
        spaces = [(match.start(), source.index('\n}\n', match.start()), match[1])
                  for match in re.finditer(r'^namespace (\w+)\n\{', source, re.MULTILINE)
                  if match[1] != 'closedloop']
        for match in re.finditer(r'\benum (?:class )?(\w*)\s*(?:: \w+)?\s*\{([^}]*)\}', source):
            inside = [space for begin, end, space in spaces if begin < match.start() < end]
            first = re.match(r'\s*(\w+)', match[2])[1]
            title = '.'.join(filter(None, [*inside, match[1]]))
            if not inside and (not match[1] or not name.endswith('.hpp') or 'Py' in match[1]):
                title = f'{name}: {match[1] or first}'
            found[title] = values(match[2], known)
            known.update({f'{title}::{key}': value for key, value in found[title].items()})
    return found


def test_every_enum_is_compared_or_the_engine_s_alone():
    found = set(enums())
    assert found == {*ENUMS, *INNER}


@pytest.mark.parametrize('name', ENUMS)
def test_columns_and_codes_are_those_of_python(name):
    module, others = ENUMS[name]
    found = enums()[name]
    assert found
    expected = {key: getattr(module, others.get(key, key)) for key in found
                if others.get(key, key) is not None}
    assert {key: found[key] for key in expected} == expected


@pytest.mark.parametrize('name, constant', [
    (name, constant) for name, (_, constants) in CONSTANTS.items() for constant in constants])
def test_constants_are_those_of_python(name, constant):
    found = re.findall(rf'constexpr \w+ (?:[^;]*[ ,])?{constant} = ([-+.e\d]+)[,;]',
                       text(FOLDER / name))
    assert [float(number) for number in found] == [getattr(CONSTANTS[name][0], constant)]


def fields():
    """Return the fields of the records that bindings read, as declared and as visited, by name."""
    found = {}
    for source in sources().values():
        for match in re.finditer(r'^struct (\w+)(?: : \w+)?\n\{(.*?)^\};', source,
                                 re.MULTILINE | re.DOTALL):
            visited = re.search(
                r'void fields\(.*?visit\(\s*((?:"[^"]*"\s*)+),([^)]*)\);', match[2], re.DOTALL)
            if visited:
                items = re.sub(r'"\s*"', '', visited[1]).strip(' "\n').split(', ')
                found[match[1]] = ([re.search(r'[a-z_]+', item)[0] for item in items],
                                   re.findall(r'\w+', visited[2]))
    return found


def test_every_record_has_its_tuple():
    assert set(fields()) == set(RECORDS)


@pytest.mark.parametrize('name', RECORDS)
def test_records_have_the_fields_of_the_tuples(name):
    expected = list(RECORDS[name]._fields)
    # Not the engine's: arrays of routines, which are kept.
    assert fields()[name] == 2 * (expected[:-1 if name == 'Batch' else None],)
