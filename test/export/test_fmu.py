# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Functional mock-up units: the same runs as ours, all functions of the standard, and faults."""

import ctypes
from ctypes import byref, c_bool, c_double, c_size_t, c_uint, c_void_p
from dataclasses import replace
from importlib import import_module
import io
import re
import subprocess
from xml.etree import ElementTree
from zipfile import ZipFile

from closedloop_dynamics import fmu, Linearisation, load_scene, Simulation, SimulationError
from closedloop_dynamics.cli import main
from closedloop_dynamics.engine import build
from closedloop_dynamics.export.c_run import compiled
from closedloop_dynamics.mechanism.errors import InaccuracyWarning
from closedloop_dynamics.scene.key_paths import changed, resolve
from closedloop_dynamics.simulation.guards import ENERGY_WARN
import numpy as np
import pytest

pytestmark = pytest.mark.skipif(
    not build.compiler(), reason='needs a C++ compiler, to compile what is written')
RK4 = {'integrator': 'rk4', 'step_size': 1e-3, 'stabilisation': 'projection'}
PRECISE = {'integrator': 'dop853', 'tolerance': 1e-12}


def simulation_of(scene, method=None, values=()):
    scene = load_scene(scene)
    scene = changed(scene, {resolve(scene, key): value for key, value in dict(values).items()})
    return Simulation.from_scene(replace(scene, method=replace(scene.method, **(method or RK4))))


def sources_of(unit):
    with ZipFile(io.BytesIO(unit.archive)) as archive:
        return {name.partition('/')[2]: archive.read(name).decode()
                for name in archive.namelist() if name.startswith('sources/')}


class Unit:
    """A unit in this process, called through ctypes."""

    def __init__(self, folder, unit, version='3.0'):
        with ZipFile(io.BytesIO(unit.archive)) as archive:
            binary = next(name for name in archive.namelist() if name.startswith('binaries/'))
            path = folder / f'unit{version}.so'
            path.write_bytes(archive.read(binary))
            root = ElementTree.fromstring(archive.read('modelDescription.xml'))
        self.library = ctypes.CDLL(str(path))
        self.token = (root.get('instantiationToken') or root.get('guid')).encode()
        self.place = {one.name: n for n, one in enumerate(unit.variables)}

    def instance(self, exchange=False):
        make = getattr(self.library, f'fmi3Instantiate{"ModelExchange" if exchange else ""}'
                                     f'{"" if exchange else "CoSimulation"}')
        make.restype = c_void_p
        more = () if exchange else (c_bool(0), c_bool(0), None, c_size_t(0))
        found = make(b'one', self.token, None, c_bool(0), c_bool(0), *more, None, None,
                     *(() if exchange else (None,)))
        return c_void_p(found) if found else None

    def started(self, exchange=False, values=None):
        instance = self.instance(exchange)
        assert self.call('EnterInitializationMode', instance, c_bool(0), c_double(0.0),
                         c_double(0.0), c_bool(0), c_double(0.0)) == 0
        if values:
            assert self.put(instance, values) == 0
        assert self.call('ExitInitializationMode', instance) == 0
        return instance

    def call(self, name, *arguments):
        return getattr(self.library, f'fmi3{name}')(*arguments)

    def get(self, instance, names):
        places, found = self._places(names), np.zeros(len(names))
        assert self.call('GetFloat64', instance, places, c_size_t(len(names)), _pointer(found),
                         c_size_t(len(names))) == 0
        return found

    def put(self, instance, values):
        places, given = self._places(values), np.array(list(values.values()), dtype=float)
        return self.call('SetFloat64', instance, places, c_size_t(len(given)), _pointer(given),
                         c_size_t(len(given)))

    def step(self, instance, now, size):
        flags, last = [c_bool() for _ in range(3)], c_double()
        return self.call('DoStep', instance, c_double(now), c_double(size), c_bool(1),
                         *map(byref, flags), byref(last))

    def _places(self, names):
        return (c_uint * len(names))(*(self.place[name] for name in names))


def _pointer(array):
    return c_void_p(array.ctypes.data)


@pytest.mark.parametrize('scene', (
    'rssr_four_bar', pytest.param('four_bar', marks=pytest.mark.slow)))
def test_co_simulation_is_our_run(scene, tmp_path):
    simulation = simulation_of(scene)
    unit = Unit(tmp_path, fmu(simulation, 'machine'))
    names = [name for name in unit.place if name.endswith('.q')][:2]
    places = [simulation.coordinates.place[simulation.joint_names.index(name[:-2])]
              for name in names]
    drive = next(name for name in unit.place if name.endswith('.tau'))
    pushed, free = unit.started(values={drive: 0.3}), unit.started()
    other = simulation_of(scene)
    for step in range(20):
        assert unit.step(pushed, step * 0.01, 0.01) == unit.step(free, step * 0.01, 0.01) == 0
    # Two at once, and neither is the other.
    for instance, ours, torque in ((pushed, simulation, 0.3), (free, other, 0.0)):
        ours.step({drive[:-4]: torque}, 0.2)
        np.testing.assert_allclose(
            unit.get(instance, names), ours.position[places], rtol=0, atol=1e-9)
    assert np.abs(unit.get(pushed, names) - unit.get(free, names)).max() > 1e-4


def test_model_exchange_goes_on_through_a_change_of_coordinates(tmp_path):
    # It falls through positions that its drives no longer decide well.
    simulation = simulation_of('three_rrr', PRECISE)
    unit = Unit(tmp_path, fmu(simulation, 'machine'))
    instance, other = unit.started(exchange=True), unit.started(exchange=True)
    names = [name for name in unit.place if re.fullmatch(r'\w+\.q', name)]
    start = unit.get(other, names)

    def states(function='GetContinuousStates'):
        found = np.zeros(6)
        assert unit.call(function, instance, _pointer(found), c_size_t(6)) == 0
        return found

    flags = [c_bool() for _ in range(5)]
    assert unit.call('UpdateDiscreteStates', instance, *map(byref, flags), None) == 0
    assert unit.call('EnterContinuousTimeMode', instance) == 0

    def slope(given):
        assert unit.call('SetContinuousStates', instance, _pointer(given), c_size_t(6)) == 0
        return states('GetContinuousStateDerivatives')

    def chosen():
        places = np.zeros(3, dtype=np.int32)
        assert unit.call('GetInt32', instance, unit._places([
            f'independent.freedom[{k}]' for k in (1, 2, 3)]), c_size_t(3), _pointer(places),
            c_size_t(3)) == 0
        return [simulation.joint_names[place] for place in places]

    size, steps, changes = 2e-4, 3000, 0
    for _ in range(steps):
        x = states()
        one = slope(x)
        two = slope(x + 0.5 * size * one)
        three = slope(x + 0.5 * size * two)
        four = slope(x + size * three)
        slope(x + size / 6 * (one + 2 * two + 2 * three + four))
        event, end = c_bool(), c_bool()
        assert unit.call(
            'CompletedIntegratorStep', instance, c_bool(1), byref(event), byref(end)) == 0
        if event.value:
            assert unit.call('EnterEventMode', instance) == 0
            before, was, was_chosen = unit.get(instance, names), states(), chosen()
            assert unit.call('UpdateDiscreteStates', instance, *map(byref, flags), None) == 0
            changed = chosen() != was_chosen
            changes += changed
            # What the states are and their values change, the mechanism does not.
            assert [flag.value for flag in flags] == [False, False, changed, changed, False]
            np.testing.assert_allclose(unit.get(instance, names), before, rtol=0, atol=1e-12)
            np.testing.assert_array_equal(
                states()[:3], unit.get(instance, [f'{name}.q' for name in chosen()]))
            assert (states() == was).all() != changed
            assert unit.call('EnterContinuousTimeMode', instance) == 0
    assert changes >= 1
    # The other instance has not moved.
    np.testing.assert_array_equal(unit.get(other, names), start)
    simulation.step(None, steps * size)
    ours = simulation.position[[simulation.joint_names.index(name[:-2]) for name in names]]
    np.testing.assert_allclose(unit.get(instance, names), ours, rtol=0, atol=1e-7)


def test_directional_derivatives_are_those_of_the_linear_model(tmp_path):
    simulation = simulation_of('four_bar')
    unit = Unit(tmp_path, fmu(simulation, 'machine', derivatives=True))
    instance = unit.started(exchange=True)
    linear = Linearisation(simulation, ['crank_joint']).linear_model(
        outputs=('position', 'velocity', 'acceleration'))
    knowns = ['independent.q[1]', 'independent.qd[1]', 'crank_joint.tau']
    unknowns = [name for what in ('{}.q', 'der({}.q)', 'der({}.q,2)')
                for name in map(what.format, simulation.joint_names)]
    expected = np.hstack((linear.C, linear.D))
    for k, known in enumerate(knowns):
        found, one = np.zeros(len(unknowns)), np.ones(1)
        assert unit.call(
            'GetDirectionalDerivative', instance, unit._places(unknowns),
            c_size_t(len(unknowns)), unit._places([known]), c_size_t(1), _pointer(one),
            c_size_t(1), _pointer(found), c_size_t(len(unknowns))) == 0
        np.testing.assert_allclose(
            found, expected[:, k], rtol=0, atol=1e-10 * np.abs(expected).max())
    adjoint, seed = np.zeros(3), np.eye(len(unknowns))[-1].copy()
    assert unit.call(
        'GetAdjointDerivative', instance, unit._places(unknowns), c_size_t(len(unknowns)),
        unit._places(knowns), c_size_t(3), _pointer(seed), c_size_t(len(unknowns)),
        _pointer(adjoint), c_size_t(3)) == 0
    np.testing.assert_allclose(adjoint, expected[-1], atol=1e-10 * np.abs(expected).max())


def test_parameters_are_numbers_of_the_scene(tmp_path):
    simulation = simulation_of('four_bar')
    unit = Unit(tmp_path, fmu(simulation, 'machine'))
    # Together: what one of them does may not depend on another.
    rng = np.random.default_rng(4)
    values = {name: variable.start * (1.0 + 0.03 * rng.normal()) for name, variable in zip(
        unit.place, fmu(simulation, 'machine', binary=False).variables)
        if variable.causality == 'parameter' and not name.startswith('step_')}
    assert len(values) >= 8 and 'mechanism.bodies.crank.mass' in values
    instance = unit.started(values=values)
    ours = simulation_of('four_bar', values={
        re.sub(r'\[(\d)\]', r'.\1', name): value for name, value in values.items()})
    ours.set_state(unit.get(instance, [f'{one}.q' for one in ours.joint_names]))
    expected, _ = ours.forward_dynamics(ours.position, np.zeros(3))
    found = unit.get(instance, [f'der({one}.q,2)' for one in ours.joint_names])
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    # While it runs a mass may change, a length may not.
    assert unit.put(instance, {'mechanism.bodies.crank.mass': 0.6}) == 0
    assert unit.put(instance, {'mechanism.joints.coupler_joint.position[0]': 0.11}) == 3


def test_states_are_kept_and_written(tmp_path):
    unit = Unit(tmp_path, fmu(simulation_of('four_bar'), 'machine'))
    instance = unit.started()
    assert unit.step(instance, 0.0, 0.1) == 0
    state, names = c_void_p(), ['crank_joint.q', 'der(crank_joint.q)']
    assert unit.call('GetFMUState', instance, byref(state)) == 0
    size = c_size_t()
    assert unit.call('SerializedFMUStateSize', instance, state, byref(size)) == 0
    text = (ctypes.c_ubyte * size.value)()
    assert unit.call('SerializeFMUState', instance, state, text, size) == 0
    assert unit.step(instance, 0.1, 0.1) == 0
    expected = unit.get(instance, names)
    assert unit.call('FreeFMUState', instance, byref(state)) == 0 and not state.value
    assert unit.call('DeserializeFMUState', instance, text, size, byref(state)) == 0
    assert unit.call('SetFMUState', instance, state) == 0
    assert unit.step(instance, 0.1, 0.1) == 0
    assert np.array_equal(unit.get(instance, names), expected)
    text[0] ^= 1
    assert unit.call('DeserializeFMUState', instance, text, size, byref(state)) == 3
    unit.call('FreeFMUState', instance, byref(state))


def test_faults_are_errors_and_leave_the_state(tmp_path):
    unit = Unit(tmp_path, fmu(simulation_of('four_bar'), 'machine'))
    right = unit.token
    unit.token = b'another'
    assert unit.instance() is None
    unit.token = right
    instance = unit.started()
    before = unit.get(instance, ['crank_joint.q'])
    assert unit.step(instance, 0.5, 0.01) == 3
    assert unit.call('EnterInitializationMode', instance, c_bool(0), c_double(0), c_double(0),
                     c_bool(0), c_double(0)) == 3
    assert unit.put(instance, {'crank_joint.tau': float('nan')}) == 3
    assert unit.put(instance, {'crank_joint.tau': 1e200}) == 0
    assert unit.step(instance, 0.0, 0.01) == 2
    assert np.array_equal(unit.get(instance, ['crank_joint.q']), before)
    assert unit.call('Reset', instance) == 0
    unit.call('FreeInstance', instance)


@pytest.mark.parametrize('version', (
    '3.0', pytest.param('2.0', marks=pytest.mark.slow)))
def test_a_unit_warns_of_its_step_size_in_the_words_of_the_package(version, tmp_path):
    method, limit = {**RK4, 'step_size': 1e-2}, 'step_cost.energy_limit'
    simulation = simulation_of('three_rrr_vertical', method)
    written = fmu(simulation, 'machine', version)
    names = [f'step_cost.{what}' for what in ('position', 'velocity', 'residual')]
    place = [one.name for one in written.variables].index
    for name, text in sources_of(written).items():
        (tmp_path / name).write_text(text)
    (tmp_path / 'run.c').write_text(WARNED[version] % (place(limit), place(names[0])))
    subprocess.run([*build.compiler(), '-x', 'c', '-std=c99', '-Wall', '-Wextra', '-Werror',
                    tmp_path / 'run.c', '-o', tmp_path / 'run', '-lm'], check=True)

    def run(share):
        *lines, last = subprocess.run(
            [tmp_path / 'run', str(share)], check=True, capture_output=True,
            text=True).stdout.splitlines()
        return lines, np.array(last.split(), dtype=float)

    lines, cost = run(ENERGY_WARN)
    with pytest.warns(InaccuracyWarning) as warned:
        for _ in range(60):
            simulation.step(None, 0.05)
    status, reported = lines[0].split(' ', 1)
    ours = str(warned[0].message)
    assert (status, len(lines), len(warned)) == ('1', 1, 1)
    words, number = ' does not follow this motion. ', r'\d[-+.\de]*'
    assert reported.startswith('logStatusWarning ')
    assert reported.endswith('Take a smaller step_size.')
    (found, _), (expected, _) = (one.split(words) for one in (reported.split(' ', 1)[1], ours))
    assert re.sub(number, '', found) == re.sub(number, '', expected)
    np.testing.assert_allclose(*([float(one) for one in re.findall(r' (\d[\d.e-]*)', text)]
                                 for text in (found, expected)), rtol=6e-3)
    np.testing.assert_allclose(cost[2], simulation.energy_balance.residual, rtol=1e-6)
    assert 0.0 < cost[0] < cost[1]
    # Without being asked nothing is measured.
    lines, cost = run(0.0)
    assert lines == [] and not cost.any()


# A run of 3 s: warnings with the status of their step, then what steps cost.
WARNED = {
    '3.0': """
#include "fmu.c"
static void log_message(void *to, fmi3Status status, const char *category, const char *text)
{
  (void)to;
  printf("%%d %%s %%s\\n", status, category, text);
}
int main(int count, char **text)
{
  Instance *one = fmi3InstantiateCoSimulation(
    "", token, 0, 0, 0, 0, 0, 0, 0, 0, log_message, 0);
  const unsigned limit = %d, first = %d, cost[] = {first, first + 1, first + 2};
  double share = atof(text[count - 1]), found[3], last;
  bool a, b, c;
  int warnings = 0;
  if (fmi3EnterInitializationMode(one, false, 0, 0, false, 0) != OK ||
      fmi3SetFloat64(one, &limit, 1, &share, 1) != OK ||
      fmi3ExitInitializationMode(one) != OK)
  {
    return 1;
  }
  for (int n = 0; n < 60; ++n) {
    const int status = fmi3DoStep(one, 0.05 * n, 0.05, true, &a, &b, &c, &last);
    warnings += status == WARNING;
    if (status > WARNING) {
      return 2;
    }
  }
  if (warnings != (share > 0.0) || fmi3GetFloat64(one, cost, 3, found, 3) != OK) {
    return 3;
  }
  printf("%%.17g %%.17g %%.17g\\n", found[0], found[1], found[2]);
  fmi3FreeInstance(one);
  return 0;
}
""",
    '2.0': """
#include "fmu.c"
#include <stdarg.h>
static void log_message(
  void *to, const char *name, fmi2Status status, const char *category, const char *text, ...)
{
  va_list arguments;
  (void)to;
  (void)name;
  printf("%%d %%s ", status, category);
  va_start(arguments, text);
  vprintf(text, arguments);
  va_end(arguments);
  puts("");
}
int main(int count, char **text)
{
  const fmi2CallbackFunctions functions = {log_message, 0, 0, 0, 0};
  Instance *one = fmi2Instantiate("", 1, token, 0, &functions, 0, 0);
  const unsigned limit = %d, first = %d, cost[] = {first, first + 1, first + 2};
  double share = atof(text[count - 1]), found[3];
  int warnings = 0;
  if (fmi2EnterInitializationMode(one) != OK || fmi2SetReal(one, &limit, 1, &share) != OK ||
      fmi2ExitInitializationMode(one) != OK)
  {
    return 1;
  }
  for (int n = 0; n < 60; ++n) {
    const int status = fmi2DoStep(one, 0.05 * n, 0.05, 1);
    warnings += status == WARNING;
    if (status > WARNING) {
      return 2;
    }
  }
  if (warnings != (share > 0.0) || fmi2GetReal(one, cost, 3, found) != OK) {
    return 3;
  }
  printf("%%.17g %%.17g %%.17g\\n", found[0], found[1], found[2]);
  fmi2FreeInstance(one);
  return 0;
}
"""}


@pytest.mark.parametrize('version', (
    '3.0', pytest.param('2.0', marks=pytest.mark.slow)))
def test_every_function_of_the_standard_is_there_and_does_no_harm(version, tmp_path):
    unit = fmu(simulation_of('four_bar'), 'machine', version)
    program = tmp_path / 'calls.c'
    files = sources_of(unit)
    # In a process with the sanitizer: an instance, a step, and each function without variables.
    program.write_text('#include "fmu.c"\n' + (CALLS_3 if version == '3.0' else CALLS_2))
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    expanded = subprocess.run([*build.compiler(), '-x', 'c', '-std=c99', '-E', '-P', program],
                              check=True, capture_output=True, text=True).stdout
    defined, called = (set(re.findall(r'\bfmi\d\w+(?=\s*\()', part))
                       for part in expanded.split('int main'))
    assert len(defined) >= {'3.0': 75, '2.0': 40}[version] and defined - called == set()
    subprocess.run(
        [*build.compiler(), '-x', 'c', '-std=c99', '-g', '-Wall', '-Wextra', '-Werror',
         '-fsanitize=address,undefined', '-fno-sanitize-recover=all', program, '-o',
         tmp_path / 'calls', '-lm'], check=True)
    subprocess.run([tmp_path / 'calls'], check=True)


CALLS_3 = """
#define CHECK(wanted, call) if ((call) != (wanted)) {return __LINE__ & 127;}
int main(void)
{
  Instance *me = fmi3InstantiateModelExchange("me", token, 0, 0, 0, 0, 0);
  Instance *cs = fmi3InstantiateCoSimulation("cs", token, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0);
  bool a, b, c, d, e;
  double one = 0.0, x[2 * FREE + 1];
  size_t count;
  void *state = 0;
  int whole;
  const unsigned freedom = FREEDOM, tau = TAU;
  CHECK(0, !me || !cs)
  CHECK(0, fmi3InstantiateScheduledExecution("", token, 0, 0, 0, 0, 0, 0, 0, 0) != 0)
  CHECK(0, strcmp(fmi3GetVersion(), "3.0"))
  CHECK(OK, fmi3SetDebugLogging(cs, true, 0, 0))
  CHECK(OK, fmi3EnterInitializationMode(me, false, 0, 0, false, 0))
  CHECK(OK, fmi3ExitInitializationMode(me))
  CHECK(OK, fmi3EvaluateDiscreteStates(me))
  CHECK(OK, fmi3UpdateDiscreteStates(me, &a, &b, &c, &d, &e, &one))
  CHECK(OK, fmi3EnterContinuousTimeMode(me))
  CHECK(OK, fmi3SetTime(me, 0.1))
  CHECK(OK, fmi3GetContinuousStates(me, x, 2 * FREE))
  CHECK(OK, fmi3SetContinuousStates(me, x, 2 * FREE))
  CHECK(OK, fmi3GetContinuousStateDerivatives(me, x, 2 * FREE))
  CHECK(OK, fmi3GetNominalsOfContinuousStates(me, x, 2 * FREE))
  CHECK(OK, fmi3GetEventIndicators(me, x, 0))
  CHECK(OK, fmi3GetNumberOfEventIndicators(me, &count))
  CHECK(OK, fmi3GetNumberOfContinuousStates(me, &count))
  CHECK(OK, fmi3CompletedIntegratorStep(me, true, &a, &b))
  CHECK(OK, fmi3EnterEventMode(me))
  CHECK(OK, fmi3GetInt32(me, &freedom, 1, &whole, 1))
  CHECK(OK, fmi3Terminate(me))
  CHECK(OK, fmi3EnterInitializationMode(cs, false, 0, 0, false, 0))
  CHECK(OK, fmi3ExitInitializationMode(cs))
  CHECK(OK, fmi3SetFloat64(cs, &tau, 1, &one, 1))
  CHECK(OK, fmi3GetFloat64(cs, &tau, 1, &one, 1))
  CHECK(OK, fmi3DoStep(cs, 0.0, 0.01, true, &a, &b, &c, &one))
  CHECK(OK, fmi3GetFMUState(cs, &state))
  CHECK(OK, fmi3SerializedFMUStateSize(cs, state, &count))
  unsigned char *bytes = malloc(count);
  CHECK(OK, fmi3SerializeFMUState(cs, state, bytes, count))
  CHECK(OK, fmi3FreeFMUState(cs, &state))
  CHECK(OK, fmi3DeserializeFMUState(cs, bytes, count, &state))
  CHECK(OK, fmi3SetFMUState(cs, state))
  CHECK(OK, fmi3FreeFMUState(cs, &state))
  free(bytes);
#define NOTHING(TYPE) CHECK(OK, fmi3Get ## TYPE(cs, 0, 0, 0, 0)) \\
  CHECK(OK, fmi3Set ## TYPE(cs, 0, 0, 0, 0))
  NOTHING(Float32) NOTHING(Int8) NOTHING(UInt8) NOTHING(Int16) NOTHING(UInt16) NOTHING(UInt32)
  NOTHING(Int64) NOTHING(UInt64) NOTHING(Boolean) NOTHING(String)
  CHECK(OK, fmi3SetInt32(cs, 0, 0, 0, 0))
  CHECK(OK, fmi3GetBinary(cs, 0, 0, 0, 0, 0))
  CHECK(OK, fmi3SetBinary(cs, 0, 0, 0, 0, 0))
  CHECK(OK, fmi3GetClock(cs, 0, 0, 0))
  CHECK(OK, fmi3SetClock(cs, 0, 0, 0))
  CHECK(OK, fmi3GetIntervalDecimal(cs, 0, 0, 0, 0))
  CHECK(OK, fmi3GetIntervalFraction(cs, 0, 0, 0, 0, 0))
  CHECK(OK, fmi3GetShiftDecimal(cs, 0, 0, 0))
  CHECK(OK, fmi3GetShiftFraction(cs, 0, 0, 0, 0))
  CHECK(OK, fmi3SetIntervalDecimal(cs, 0, 0, 0))
  CHECK(OK, fmi3SetIntervalFraction(cs, 0, 0, 0, 0))
  CHECK(OK, fmi3SetShiftDecimal(cs, 0, 0, 0))
  CHECK(OK, fmi3SetShiftFraction(cs, 0, 0, 0, 0))
  CHECK(OK, fmi3GetOutputDerivatives(cs, 0, 0, 0, 0, 0))
  CHECK(ERROR, fmi3GetDirectionalDerivative(cs, &tau, 1, &tau, 1, &one, 1, &one, 1))
  CHECK(ERROR, fmi3GetAdjointDerivative(cs, &tau, 1, &tau, 1, &one, 1, &one, 1))
  CHECK(ERROR, fmi3GetNumberOfVariableDependencies(cs, 0, &count))
  CHECK(ERROR, fmi3GetVariableDependencies(cs, 0, 0, 0, 0, 0, 0))
  CHECK(ERROR, fmi3EnterConfigurationMode(cs))
  CHECK(ERROR, fmi3ExitConfigurationMode(cs))
  CHECK(ERROR, fmi3EnterStepMode(cs))
  CHECK(ERROR, fmi3ActivateModelPartition(cs, 0, 0.0))
  CHECK(OK, fmi3Reset(cs))
  fmi3FreeInstance(me);
  fmi3FreeInstance(cs);
  return 0;
}
"""

CALLS_2 = """
#define CHECK(wanted, call) if ((call) != (wanted)) {return __LINE__ & 127;}
int main(void)
{
  Instance *me = fmi2Instantiate("me", 0, token, 0, 0, 0, 0);
  Instance *cs = fmi2Instantiate("cs", 1, token, 0, 0, 0, 0);
  double one = 0.0, x[2 * FREE + 1];
  size_t count;
  void *state = 0;
  int a, b;
  const char *words;
  fmi2EventInfo info;
  const unsigned freedom = FREEDOM, tau = TAU;
  CHECK(0, !me || !cs)
  CHECK(0, strcmp(fmi2GetVersion(), "2.0") || strcmp(fmi2GetTypesPlatform(), "default"))
  CHECK(OK, fmi2SetDebugLogging(cs, 1, 0, 0))
  CHECK(OK, fmi2SetupExperiment(me, 0, 0, 0, 0, 0))
  CHECK(OK, fmi2EnterInitializationMode(me))
  CHECK(OK, fmi2ExitInitializationMode(me))
  CHECK(OK, fmi2NewDiscreteStates(me, &info))
  CHECK(OK, fmi2EnterContinuousTimeMode(me))
  CHECK(OK, fmi2SetTime(me, 0.1))
  CHECK(OK, fmi2GetContinuousStates(me, x, 2 * FREE))
  CHECK(OK, fmi2SetContinuousStates(me, x, 2 * FREE))
  CHECK(OK, fmi2GetDerivatives(me, x, 2 * FREE))
  CHECK(OK, fmi2GetNominalsOfContinuousStates(me, x, 2 * FREE))
  CHECK(OK, fmi2GetEventIndicators(me, x, 0))
  CHECK(OK, fmi2CompletedIntegratorStep(me, 1, &a, &b))
  CHECK(OK, fmi2EnterEventMode(me))
  CHECK(OK, fmi2GetInteger(me, &freedom, 1, &a))
  CHECK(OK, fmi2Terminate(me))
  CHECK(OK, fmi2EnterInitializationMode(cs))
  CHECK(OK, fmi2ExitInitializationMode(cs))
  CHECK(OK, fmi2SetReal(cs, &tau, 1, &one))
  CHECK(OK, fmi2GetReal(cs, &tau, 1, &one))
  CHECK(OK, fmi2DoStep(cs, 0.0, 0.01, 1))
  CHECK(OK, fmi2GetFMUstate(cs, &state))
  CHECK(OK, fmi2SerializedFMUstateSize(cs, state, &count))
  unsigned char *bytes = malloc(count);
  CHECK(OK, fmi2SerializeFMUstate(cs, state, bytes, count))
  CHECK(OK, fmi2FreeFMUstate(cs, &state))
  CHECK(OK, fmi2DeSerializeFMUstate(cs, bytes, count, &state))
  CHECK(OK, fmi2SetFMUstate(cs, state))
  CHECK(OK, fmi2FreeFMUstate(cs, &state))
  free(bytes);
  CHECK(OK, fmi2SetInteger(cs, 0, 0, 0))
  CHECK(OK, fmi2GetBoolean(cs, 0, 0, 0))
  CHECK(OK, fmi2SetBoolean(cs, 0, 0, 0))
  CHECK(OK, fmi2GetString(cs, 0, 0, 0))
  CHECK(OK, fmi2SetString(cs, 0, 0, 0))
  CHECK(OK, fmi2SetRealInputDerivatives(cs, 0, 0, 0, 0))
  CHECK(OK, fmi2GetRealOutputDerivatives(cs, 0, 0, 0, 0))
  CHECK(ERROR, fmi2GetDirectionalDerivative(cs, &tau, 1, &tau, 1, &one, &one))
  CHECK(ERROR, fmi2CancelStep(cs))
  CHECK(DISCARD, fmi2GetStatus(cs, 0, &a))
  CHECK(OK, fmi2GetRealStatus(cs, 2, &one))
  CHECK(DISCARD, fmi2GetIntegerStatus(cs, 0, &a))
  CHECK(OK, fmi2GetBooleanStatus(cs, 3, &a))
  CHECK(DISCARD, fmi2GetStringStatus(cs, 1, &words))
  CHECK(OK, fmi2Reset(cs))
  fmi2FreeInstance(me);
  fmi2FreeInstance(cs);
  return 0;
}
"""


# The independent coordinates of the manipulator change on the way; the slider meets its stop, of
# which there is one: the other is at infinity.
@pytest.mark.parametrize('version, scene', (
    ('3.0', 'slider_crank_end_stop'), ('2.0', 'slider_crank_end_stop'),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        ('2.0', 'three_rrr'), ('3.0', 'three_rrr')))))
def test_fmpy_finds_nothing_wrong_and_runs_it(version, scene, tmp_path):
    fmpy = pytest.importorskip('fmpy', reason='needs fmpy, from the Python package index')
    path = tmp_path / 'machine.fmu'
    path.write_bytes(fmu(simulation_of(scene), 'machine', version, True).archive)
    assert import_module('fmpy.validation').validate_fmu(str(path)) == []
    for kind, method, tolerance in (
            ('CoSimulation', RK4, 1e-9), ('ModelExchange', PRECISE, 1e-7)):
        rows = fmpy.simulate_fmu(
            str(path), fmi_type=kind, stop_time=0.6, output_interval=0.01,
            relative_tolerance=1e-12)
        ours = simulation_of(scene, method)
        ours.step(None, 0.6)
        found = [rows[f'{name}.q'][-1] for name in ours.joint_names]
        np.testing.assert_allclose(found, ours.position, rtol=0, atol=tolerance)


def test_the_command_writes_units_and_tells_what_they_lack(tmp_path, capsys):
    assert main(['export', 'rssr_four_bar', '--output', str(tmp_path / 'a.fmu')]) == 0
    assert 'no model exchange: an orientation' in capsys.readouterr().out
    assert main(['export', 'cam_follower', '--output', str(tmp_path / 'b.fmu')]) == 1
    assert 'effects.outline' in capsys.readouterr().err
    assert main(['export', 'four_bar', '--output', str(tmp_path / 'c.c'), '--fmi', '2.0']) == 2
    assert '--fmi: expected it with an output that ends with .fmu' in capsys.readouterr().err


def test_what_does_not_compile_is_reported_with_the_reason():
    with pytest.raises(SimulationError, match='could not be compiled'):
        compiled({'machine.c': '', 'fmu.c': 'no C'}, 'fmu.c')
