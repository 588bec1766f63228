# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A scene as a functional mock-up unit (FMI 2.0, 3.0): its C, a description, and a binary.

The unit is the C of ``c_source`` within the interface of ``fmu_template``. In model exchange its
states are as many joint coordinates as there are degrees of freedom, and their rates; the other
joints follow from the loops. An event takes others where they determine the motion better.
"""

import hashlib
import io
import platform
import re
import sys
from typing import NamedTuple
from xml.etree import ElementTree
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from .c_run import compiled
from .c_source import c_source
from .fmu_template import BOTH, COMMON, FMI2, FMI3, WORDS
from ..codegen import space
from ..codegen.function_table import VALUE_COLUMNS
from ..mechanism.coordinates import QUANTITIES
from ..mechanism.errors import SimulationError
from ..mechanism.fields import FieldError
from ..mechanism.mechanism import MechanismError
from ..scene.key_paths import changed, numbers, resolve
from ..simulation.parameters import finite

VERSIONS = ('3.0', '2.0')
# Pivots below this share of the largest are rounding.
RANK_TOLERANCE = 1e-8
# What is varied to see how the model follows from a parameter, beside its size or 1.
VARIED = 1e-3
# Exponents of kg, m, s, rad.
_UNITS = {
    'rad': (0, 0, 0, 1), 'rad/s': (0, 0, -1, 1), 'rad/s2': (0, 0, -2, 1), 'm': (0, 1, 0, 0),
    'm/s': (0, 1, -1, 0), 'm/s2': (0, 1, -2, 0), 'N': (1, 1, -2, 0), 'N.m': (1, 2, -2, 0),
    'J': (1, 2, -2, 0), 'kg': (1, 0, 0, 0), 'kg.m2': (1, 2, 0, 0), 's': (0, 0, 1, 0)}
# Parameters that may change while the model runs, and those that may not, by key path. In space
# the code is made for what is equal among moments of inertia and placements.
_TUNABLE = re.compile(r'mechanism\.bodies\.[^.]+\.(mass|inertia)$|effects\.')
_FIXED = re.compile(r'mechanism\.(joints|cut_joints)\.')


class Variable(NamedTuple):
    """One variable of the description, in the order of the value references."""

    name: str
    causality: str
    variability: str
    initial: str = None
    start: float = None
    unit: str = None
    description: str = ''
    derivative: int = None  # Value reference of the quantity of which this is the derivative
    whole: bool = False  # Whether it is an integer


class Fmu(NamedTuple):
    """A functional mock-up unit."""

    archive: bytes  # What the file holds
    variables: tuple  # Tuple of Variable
    no_exchange: str  # Why there is no model exchange


def fmu(simulation, name, version='3.0', derivatives=False, binary=True):
    """
    Write a scene as a functional mock-up unit.

    Parameters
    ----------
    simulation : Simulation
        In the state to start from.
    name : str
        Of the model: letters, digits and _.
    version : str
        Of FMI: ``'3.0'`` or ``'2.0'``.
    derivatives : bool
        Whether to provide directional derivatives, which take most of the code.
    binary : bool
        Whether to compile for this machine; the sources are always there.

    Returns
    -------
    Fmu

    Raises
    ------
    ValueError
        For a name that C does not take, or another version.
    SimulationError
        Where something of the scene has no C, with names and reasons; where two variables have
        one name; where there is no compiler, or it fails.

    """
    if version not in VERSIONS:
        raise ValueError(f'version: expected one of {", ".join(VERSIONS)}, got {version!r}')
    source, header = c_source(simulation, name, derivatives)
    unit = _Unit(simulation, name, version, derivatives)
    files = {f'{name}.c': source, f'{name}.h': header, 'fmu.c': unit.interface()}
    token = '{' + _token(files, version) + '}'
    files['fmu.c'] = files['fmu.c'].replace('@TOKEN@', token)
    entries = {'modelDescription.xml': unit.description(token)}
    entries |= {f'sources/{place}': text for place, text in files.items()}
    if version == '3.0':
        entries['sources/buildDescription.xml'] = _build_description(name)
    if binary:
        folder, ending = _platform(version)
        entries[f'binaries/{folder}/{name}{ending}'] = compiled(files, 'fmu.c')
    return Fmu(_archive(entries), tuple(unit.variables), unit.no_exchange)


def _token(files, version):
    """Return the token that identifies the unit: the same for the same sources."""
    digest = hashlib.sha256(repr((sorted(files.items()), version)).encode()).hexdigest()
    return '-'.join((digest[:8], digest[8:12], digest[12:16], digest[16:20], digest[20:32]))


def _platform(version):
    """Return the folder of binaries of this machine, and how their names end."""
    machine = {'amd64': 'x86_64', 'arm64': 'aarch64'}.get(
        platform.machine().lower(), platform.machine().lower())
    system, ending = {'linux': ('linux', '.so'), 'darwin': ('darwin', '.dylib')}[sys.platform]
    if version == '2.0':
        return (f'{system}64' if machine == 'x86_64' else f'{machine}-{system}'), ending
    return f'{machine}-{system}', ending


def _archive(entries):
    """Return a ZIP archive, the same for the same entries."""
    out = io.BytesIO()
    with ZipFile(out, 'w', ZIP_DEFLATED) as archive:
        for place, content in entries.items():
            info = ZipInfo(place)
            info.compress_type = ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            archive.writestr(info, content)
    return out.getvalue()


def _build_description(name):
    root = ElementTree.Element('fmiBuildDescription', fmiVersion='3.0')
    configuration = ElementTree.SubElement(root, 'BuildConfiguration', modelIdentifier=name)
    files = ElementTree.SubElement(configuration, 'SourceFileSet', language='C99')
    ElementTree.SubElement(files, 'SourceFile', name='fmu.c')
    return _text(root)


def _text(root):
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='UTF-8', xml_declaration=True)


class _Unit:
    """The parts of one unit."""

    def __init__(self, simulation, name, version, derivatives):
        """Choose the independent coordinates, find the parameters, and list the variables."""
        self.simulation, self.name, self.version = simulation, name, version
        self.derivatives, self.coordinates = derivatives, simulation.coordinates
        names = simulation.joint_names
        self.inputs = [names.index(one) for one in simulation.actuated_joints if one in names]
        balls = self.coordinates.place < 0
        self.weight = np.ones(len(names))
        self.weight[self.inputs] = 0.1
        self.weight[balls] = 1e6
        self.choice, self.no_exchange = self._choice(balls)
        self.parameters = _parameters(simulation)
        self.variables = self._variables()
        seen = set()
        for one in self.variables:
            if one.name in seen:
                raise SimulationError(
                    f'{simulation.scene.name} cannot be written as an FMU: two variables would '
                    f'be called {one.name}. Rename a joint or a point.')
            seen.add(one.name)

    def _choice(self, balls):
        """Return independent freedoms, or why there are none."""
        from scipy.linalg import qr
        jac = self.simulation.constraint_jacobian
        nc, nv = len(self.simulation.data.system.lam), jac.shape[1]
        if nc == nv:
            return [], 'there is no degree of freedom'
        if nc == 0:
            return ([], 'orientations have no independent coordinates') if balls.any() else (
                list(range(nv)), None)
        _, r, order = qr(jac * self.weight, mode='economic', pivoting=True)
        pivots = np.abs(np.diag(r))[:nc] / self.weight[order[:nc]]
        free = sorted(order[nc:].tolist())
        if pivots.min() <= RANK_TOLERANCE * pivots.max():
            return [], 'closure equations depend on one another where the scene starts'
        if balls[free].any():
            return [], ('an orientation does not follow from the other joints, and has no '
                        'independent coordinates')
        return free, None

    def interface(self):
        """Return the C of the interface, without the token."""
        simulation, words = self.simulation, [one.key for one in self.parameters]
        shares = [(number, place, share) for number, one in enumerate(self.parameters)
                  for place, share in one.shares]
        fill = WORDS[self.version] | {
            'NAME': self.name, 'UPPER': self.name.upper(), 'VERSION': self.version,
            'SIZE': str(2 if simulation.mechanism.planar else 3),
            'INPUTS': str(len(self.inputs)), 'PARAMETERS': str(len(words)),
            'FREE': str(len(self.choice)), 'EXCHANGE': str(int(self.no_exchange is None)),
            'DERIVATIVES': str(int(self.derivatives)), 'TOKEN': '@TOKEN@',
            'INPUT': _listed([*self.inputs, 0]),
            'COORDINATE': _listed(self.coordinates.place.tolist()),
            'WEIGHT': _listed(self.weight.tolist()), 'CHOICE': _listed([*self.choice, 0]),
            'STARTS': _listed([*(one.value for one in self.parameters), 0.0]),
            'TUNABLE': _listed([*(int(one.tunable) for one in self.parameters), 0]),
            'SHARES': str(len(shares)),
            'SHARE': ',\n'.join(
                f'  {{{number}, offsetof({self.name}_model, {member}) / sizeof(double) + {place}, '
                f'{share!r}}}' for number, (member, place), share in shares + [
                    (0, ('closure_limit', 0), 0.0)]),
            'LONGEST': repr(float(simulation.scene.method.step_size))}
        return re.sub('@([A-Z]+)@', lambda match: fill[match[1]],
                      COMMON + (FMI3 if self.version == '3.0' else FMI2) + BOTH)

    def _variables(self):
        """Return the variables by their value references."""
        simulation, size = self.simulation, 2 if self.simulation.mechanism.planar else 3
        names, slides = simulation.joint_names, self.coordinates.lengths
        # As the standard spells them.
        units = {what: [unit.replace('^', '').replace(' ', '.')
                        for unit in self.coordinates.units(what)] for what in QUANTITIES}
        place, balls = self.coordinates.place, self.coordinates.balls
        found = [Variable('time', 'independent', 'continuous', unit='s')]
        for number in self.inputs:
            found.append(Variable(
                f'{_structured(names[number])}.tau', 'input', 'continuous', start=0.0,
                unit=units['effort'][number], description='torque or force of the drive'))
        position, rate, acceleration = {}, [None] * len(names), [None] * len(names)
        for number, name in enumerate(names):
            if place[number] >= 0:
                own = f'{_structured(name)}.q'
                position[place[number]] = own, units['position'][number]
                rate[number], acceleration[number] = f'der({own})', f'der({own},2)'
        for first, turn in balls.tolist():
            joint = names[turn].rpartition('.')[0]
            for k, letter in enumerate('xyzw'):
                position[first + k] = f'{_structured(joint)}.orientation.{letter}', None
            for k in range(3):
                own = f'{_structured(joint)}.angular_velocity[{k + 1}]'
                rate[turn + k], acceleration[turn + k] = own, f'der({own})'
        found += [_output(*position[k], 'coordinate') for k in range(len(position))]
        found += [_output(name, unit, 'rate') for name, unit in zip(rate, units['velocity'])]
        found += [_output(name, unit, 'acceleration')
                  for name, unit in zip(acceleration, units['acceleration'])]
        found += [_output(f'multiplier[{k + 1}]', None, 'of a closure equation, in the order of '
                          f'{self.name}.h [N; N m]')
                  for k in range(len(simulation.data.system.lam))]
        found += [_output(f'{_structured(point.name)}.position[{k + 1}]', 'm', 'in the world')
                  for point in simulation.mechanism.points for k in range(size)]
        found += [Variable(f'energy.{what}', 'local', 'continuous', 'calculated', unit='J')
                  for what in ('kinetic', 'gravity', 'springs')]
        first = len(found)
        q, qd, free = simulation.position, simulation.velocity, self.choice
        for what, values, unit in (('q', q[place[free]], units['position']),
                                   ('qd', qd[free], units['velocity'])):
            found += [Variable(
                f'independent.{what}[{k + 1}]', 'local', 'continuous', 'exact', float(value),
                # The unit of the joint that is chosen now.
                unit[free[k]] if len(set(slides[place >= 0])) == 1 else None,
                f'at the start of {names[free[k]]}')
                for k, value in enumerate(values)]
        for k in range(2 * len(free)):
            found.append(Variable(f'der({found[first + k].name})', 'local', 'continuous',
                                  'calculated', derivative=first + k))
        found += [Variable(
            _structured(one.key), 'parameter', 'tunable' if one.tunable else 'fixed', 'exact',
            one.value, _unit_of(one.key)) for one in self.parameters]
        found.append(Variable(
            'step_size', 'parameter', 'fixed', 'exact', float(simulation.scene.method.step_size),
            's', 'longest step of the classical Runge-Kutta method in co-simulation'))
        found.append(Variable(
            'step_cost.energy_limit', 'parameter', 'fixed', 'exact', 0.0, description=(
                'share of the energy exchanged that the balance may miss without a warning, in '
                'co-simulation; 0: what steps cost is not measured')))
        found += [Variable(f'step_cost.{what}', 'local', 'discrete', 'calculated', unit=unit,
                           description=f'{meaning} since the start; 0 where it is not measured')
                  for what, unit, meaning in (
                      ('position', None, 'largest difference of a joint coordinate between a step '
                       'and two of half its size [rad; m]'),
                      ('velocity', None, 'the same of a rate [rad/s; m/s]'),
                      ('residual', 'J', 'error of the energy balance'))]
        meaning = ', '.join(f'{n} {name}' for n, name in enumerate(names))
        found += [Variable(
            f'independent.freedom[{k + 1}]', 'local', 'discrete', 'calculated', whole=True,
            description=meaning) for k in range(len(free))]
        return found

    def description(self, token):
        """Return modelDescription.xml."""
        three = self.version == '3.0'
        root = ElementTree.Element(
            'fmiModelDescription', fmiVersion=self.version, modelName=self.name,
            **{'instantiationToken' if three else 'guid': token},
            description=self.simulation.scene.name, generationTool='closedloop_dynamics',
            variableNamingConvention='structured',
            **({} if three else {'numberOfEventIndicators': '0'}))
        able = {'modelIdentifier': self.name,
                f'canGetAndSetFMU{"S" if three else "s"}tate': 'true',
                f'canSerializeFMU{"S" if three else "s"}tate': 'true',
                f'providesDirectionalDerivative{"s" if three else ""}': str(
                    self.derivatives).lower()}
        if three:
            able['providesAdjointDerivatives'] = able['providesDirectionalDerivatives']
        kinds = [('CoSimulation', {'canHandleVariableCommunicationStepSize': 'true'})]
        if self.no_exchange is None:
            kinds.insert(0, ('ModelExchange', {
                'needsCompletedIntegratorStep': 'true'} if three else {}))
        for kind, more in kinds:
            one = ElementTree.SubElement(root, kind, **able, **more)
            if not three:
                files = ElementTree.SubElement(one, 'SourceFiles')
                ElementTree.SubElement(files, 'File', name='fmu.c')
        self._units(ElementTree.SubElement(root, 'UnitDefinitions'))
        ElementTree.SubElement(
            root, 'DefaultExperiment', startTime='0', stopTime='1', stepSize='0.01')
        whole = ElementTree.SubElement(root, 'ModelVariables')
        for reference, one in enumerate(self.variables):
            self._variable(whole, reference, one)
        self._structure(ElementTree.SubElement(root, 'ModelStructure'))
        return _text(root)

    def _units(self, parent):
        for name in sorted({one.unit for one in self.variables} - {None}):
            unit = ElementTree.SubElement(parent, 'Unit', name=name)
            ElementTree.SubElement(unit, 'BaseUnit', **{
                base: str(power) for base, power in zip(('kg', 'm', 's', 'rad'), _UNITS[name])
                if power})

    def _variable(self, parent, reference, one):
        about = {'name': one.name, 'valueReference': str(reference), 'causality': one.causality,
                 'variability': one.variability}
        if one.initial:
            about['initial'] = one.initial
        if one.description:
            about['description'] = one.description
        special = {}
        if one.unit:
            special['unit'] = one.unit
        if one.start is not None:
            special['start'] = repr(one.start)
        if self.version == '3.0':
            if one.derivative is not None:
                special['derivative'] = str(one.derivative)
            ElementTree.SubElement(
                parent, 'Int32' if one.whole else 'Float64', **about, **special)
            return
        if one.derivative is not None:
            # By the place in the list, from 1.
            special['derivative'] = str(one.derivative + 1)
        variable = ElementTree.SubElement(parent, 'ScalarVariable', **about)
        ElementTree.SubElement(variable, 'Integer' if one.whole else 'Real', **special)

    def _structure(self, parent):
        outputs = [n for n, one in enumerate(self.variables) if one.causality == 'output']
        changes = [n for n, one in enumerate(self.variables) if one.derivative is not None]
        first = sorted(outputs + changes)
        if self.version == '3.0':
            for what, some in (('Output', outputs), ('ContinuousStateDerivative', changes),
                               ('InitialUnknown', first)):
                for n in some:
                    ElementTree.SubElement(parent, what, valueReference=str(n))
            return
        for what, some in (('Outputs', outputs), ('Derivatives', changes),
                           ('InitialUnknowns', first)):
            if some:
                group = ElementTree.SubElement(parent, what)
                for n in some:
                    ElementTree.SubElement(group, 'Unknown', index=str(n + 1))


def _output(name, unit, description):
    return Variable(name, 'output', 'continuous', 'calculated', unit=unit, description=description)


def _listed(values):
    return ', '.join(map(repr, values))


def _structured(name):
    """Return a name as structured names have it: places in brackets, as they are counted."""
    parts = []
    for part in name.split('.'):
        if part.isdigit() and parts:
            parts[-1] += f'[{part}]'
        elif re.fullmatch('[A-Za-z_][A-Za-z0-9_]*', part):
            parts.append(part)
        else:
            parts.append(f"'{re.sub('[^A-Za-z0-9_ ]', '_', part)}'")
    return '.'.join(parts)


def _unit_of(key):
    """Return the unit of a parameter; of effects it depends on the effect."""
    words = key.split('.')
    if words[1] == 'bodies':
        return 'kg' if words[3] == 'mass' else 'kg.m2'
    if words[0] == 'mechanism' and words[3] in ('position', 'point_a', 'point_b', 'length'):
        return 'm'
    return None


class _Parameter(NamedTuple):
    """A number of the scene that numbers of the model follow from, in proportion."""

    key: str
    value: float
    tunable: bool
    shares: list  # Of pairs ((member, place), share)


def _parameters(simulation):
    """
    Return the numbers of a scene that the model depends on linearly.

    Each is varied alone, and the arrays of the model are looked at: numbers that are exactly 0,
    and in space moments that are equal, have to stay so. What depends otherwise, such as the
    inertia on the centre of mass, is not a parameter.
    """
    before, found, planar = _arrays(simulation), [], simulation.mechanism.planar
    for key, value in numbers(simulation.scene).items():
        if value is None or not (_TUNABLE.match(key) or (planar and _FIXED.match(key))):
            continue
        if value == 0.0 and key.startswith('mechanism.'):
            continue
        step = VARIED * (abs(value) or 1.0)
        moved = [_varied(simulation, key, value + times * step) for times in (1.0, 2.0)]
        if any(one is None for one in moved):
            continue
        shares = _shares(before, *moved, step, planar)
        if shares:
            found.append(_Parameter(key, value, bool(_TUNABLE.match(key)), shares))
    return found


def _varied(simulation, key, value):
    """Return the arrays of the model with another value; None where that is impossible."""
    scene = simulation.scene
    try:
        other = type(simulation).from_scene(changed(scene, {resolve(scene, key): value}))
    except (FieldError, MechanismError, SimulationError):
        return None
    return _arrays(other)


def _arrays(simulation):
    system = simulation.data.system
    table = system.effects
    values = np.zeros((0, VALUE_COLUMNS)) if table is None else table.values
    return {'body': system.model.body.copy(), 'gravity': system.model.gravity.copy(),
            'cut_point': system.model.cut_point.copy(), 'effect': finite(values)}


def _shares(before, once, twice, step, planar):
    """Return the quantities that are linear in an input; none where others are not."""
    found = []
    for member, values in before.items():
        if once[member].shape != values.shape:
            return []
        first, second = once[member] - values, twice[member] - values
        scale = np.abs(values).max(initial=0.0) + np.abs(first).max(initial=0.0)
        changes = np.abs(first) > 1e-13 * scale
        if (np.abs(second - 2.0 * first) > 1e-10 * np.abs(first).max(initial=0.0)).any():
            return []
        # Numbers of effects belong to no structure; nor do masses that happen to be 1.
        structure = (values == 0.0) & (member != 'effect')
        if not planar and member == 'body':
            # Principal moments that are equal have one symbol.
            moments = slice(space.INERTIA, space.INERTIA + 3)
            for row, other in zip(values[:, moments], once[member][:, moments]):
                if any((row[a] == row[b]) != (other[a] == other[b])
                       for a, b in ((0, 1), (0, 2), (1, 2))):
                    return []
        if (changes & structure).any():
            return []
        found += [((member, int(place)), float(first.flat[place] / step))
                  for place in np.flatnonzero(changes)]
    return found
