# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Records of effects that cannot be, each refused by the key that is wrong."""

import math

from closedloop_dynamics.effects.registry import (
    Actuator, BodyContact, Bushing, Cable, Contact, EndStop, ExternalForce, FluidDrag, ForceTable,
    JointDamping, JointFriction, JointSpring, Law, MagneticSpring, Payload, PointSpring,
    PrescribedForce, PrescribedMotion, Rotor, Sensor, Tendon, TendonFriction, TendonInertia)
from closedloop_dynamics.mechanism.fields import FieldError
import pytest

from .machines import block, flyer, simulated
from .test_space import point_mass

LINE, CIRCLE = {'shape': 'line'}, {'shape': 'circle', 'other_radius': 0.1}
CURVE = {'shape': 'curve', 'x': (0.0, 1.0, 0.0), 'y': (0.0, 0.0, 1.0)}
SPHERE = {'shape': 'sphere', 'other_radius': 0.1}
STEP = {'shape': 'constant', 'joint': 'slide', 'amplitude': 1.0}
AT_POINT = {'shape': 'constant', 'point': 'center', 'amplitude': 1.0}
SINE, TRAPEZOID = {**STEP, 'shape': 'sine'}, {**STEP, 'shape': 'trapezoid', 'rise': 1.0}
TABLE = {'shape': 'table', 'joint': 'slide', 'times': (0.0, 1.0), 'values': (0.0, 1.0)}
# Of each effect: what else is given, then the key that is wrong with what makes it so.
IMPOSSIBLE = [
    (Actuator, {'joint': 'slide'}, [
        ('max_torque', {'max_torque': 0.0}), ('max_speed', {'max_speed': -1.0}),
        ('lag', {'lag': -1.0}), ('delay', {'delay': -1.0})]),
    (BodyContact, {'point': 'front', 'other': 'rear', 'stiffness': 1.0}, [
        ('stiffness', {**LINE, 'stiffness': 0.0}), ('radius', {**LINE, 'radius': -1.0}),
        ('exponent', {**LINE, 'exponent': 0.5}), ('hollow', {**LINE, 'hollow': True}),
        ('restitution', {**LINE, 'restitution': 0.5}),
        ('restitution', {**LINE, 'restitution': 1.5, 'impact_velocity': 1.0}),
        ('damping', {**LINE, 'restitution': 0.5, 'impact_velocity': 1.0, 'damping': 0.1}),
        ('other_radius', {'shape': 'circle'}),
        ('radius', {**CIRCLE, 'radius': 0.2, 'hollow': True}),
        ('x', {**CURVE, 'x': (0.0, 1.0)}), ('y', {**CURVE, 'y': (0.0, 1.0)}),
        ('x', {**CURVE, 'radii': (1.0, 1.0, 1.0)}), ('x', {'shape': 'curve'}),
        ('x[0]', {**CURVE, 'x': (0.0, 0.0, 1.0), 'y': (0.0, 0.0, 1.0)}),
        ('x', {**CURVE, 'x': (0.0, 3.7e298, 1.0)}), ('x', {**CURVE, 'x': (0.0, 1.0, 1e20)}),
        ('x', {**CURVE, 'x': (0.0, 3.7e298, 1.0), 'interpolation': 'linear'}),
        ('x', {'shape': 'curve', 'radii': (1.0, 1.0, 1e160, 1.0)}),
        ('other_radius', {**CURVE, 'other_radius': 1.0}),
        ('radii[1]', {'shape': 'curve', 'radii': (1.0, -1.0, 1.0)}),
        ('x', {'shape': 'curve', 'radii': (1.0, 1.0, 1.0), 'polar': '1.0 + 0.1*sin(a)'}),
        ('polar', {'shape': 'curve', 'polar': '1.0 + 2*sin(a)'}),
        ('polar', {'shape': 'curve', 'polar': '1.0 + sin(b)'}),
        ('polar', {'shape': 'curve', 'polar': '0.03 + 0.002*a'}),
        ('polar', {'shape': 'curve', 'polar': '1.0 + 0.1*sin(0.5*a + 1)',
                   'interpolation': 'linear'}),
        ('polar', {'shape': 'face', 'polar': '0.03 + 1e-4*a'}),
        ('radius', {'shape': 'face', 'polar': '1.0', 'radius': 0.1}), ('x', {'shape': 'face'}),
        ('hollow', {'shape': 'face', 'polar': '1.0', 'hollow': True}),
        ('normal', {'shape': 'plane'}), ('axis', {'shape': 'cylinder', 'other_radius': 0.1}),
        ('other_radius', {'shape': 'sphere'}), ('axis', {**SPHERE, 'axis': (0.0, 0.0, 1.0)}),
        ('normal', {'shape': 'plane', 'normal': (0.0, 0.0, 0.0)}),
        ('radius', {**SPHERE, 'radius': 0.2, 'hollow': True})]),
    (Bushing, {'point_a': 'front'}, [
        ('point_b', {}), ('point_b', {'point_b': 'rear', 'anchor': (0, 0)}),
        ('stiffness', {'point_b': 'rear', 'stiffness': (1.0,)}),
        ('stiffness[1]', {'point_b': 'rear', 'stiffness': (1.0, -1.0)}),
        ('turning_damping', {'point_b': 'rear', 'turning_damping': -1.0})]),
    (Cable, {'points': ('a', 'b'), 'stiffness': 1.0, 'free_length': 1.0}, [
        ('points', {'points': ('a',)}), ('stiffness', {'stiffness': 0.0}),
        ('free_length', {'free_length': -1.0}), ('radii', {'radii': (0.0,)}),
        ('radii[0]', {'radii': (0.1, 0.0)}), ('damping', {'damping': -1.0}),
        ('axis', {'axis': (0.0, 0.0, 1.0)})]),
    (Contact, {'point': 'ball', 'origin': (0.0, 0.0), 'stiffness': 1.0}, [
        ('stiffness', {'stiffness': 0.0}), ('exponent', {'exponent': 0.5}),
        ('friction', {'friction': -1.0}), ('slip_velocity', {'slip_velocity': 0.0}),
        ('damping', {'damping': math.nan})]),
    (EndStop, {'joint': 'slide', 'stiffness': 1.0}, [
        ('stiffness', {'stiffness': 0.0, 'upper': 1.0}), ('lower', {}),
        ('upper', {'lower': 1.0, 'upper': 0.5}), ('damping', {'upper': 1.0, 'damping': -1.0})]),
    (FluidDrag, {'point': 'center'}, [
        ('linear[1]', {'linear': (1.0, -1.0)}), ('quadratic', {'quadratic': (1.0,)}),
        ('turning_linear', {'turning_linear': -1.0}), ('flow', {'flow': 'x'})]),
    (ForceTable, {'strokes': (0.0, 1.0), 'forces': (0.0, 1.0)}, [
        ('joint', {}), ('joint', {'joint': 'slide', 'point_a': 'rim'}),
        ('point_b', {'point_a': 'rim'}), ('strokes', {'joint': 'slide', 'strokes': (0.0,)}),
        ('strokes[1]', {'joint': 'slide', 'strokes': (0.0, 0.0)}),
        ('forces', {'joint': 'slide', 'forces': (0.0,)}),
        ('damping', {'joint': 'slide', 'damping': -1.0}),
        ('interpolation', {'joint': 'slide', 'interpolation': 'quadratic'})]),
    (JointDamping, {'joint': 'slide', 'coefficient': 1.0}, [
        ('coefficient', {'coefficient': -1.0}), ('coefficient', {'coefficient': 'much'}),
        ('joint', {'joint': 3})]),
    (JointFriction, {'joint': 'slide'}, [
        ('coulomb', {'coulomb': -1.0}), ('static_ratio', {'static_ratio': 0.5}),
        ('stribeck_velocity', {'stribeck_velocity': 0.0}), ('load_time', {'load_time': 0.0}),
        ('radius', {'radius': 0.0})]),
    (JointSpring, {'joint': 'slide'}, [('stiffness', {'stiffness': -1.0})]),
    (Law, {'forces': {'x': '-x'}, 'joints': {'x': 'slide'}}, [
        ('forces', {'forces': {}}), ('forces', {'forces': 'x'}),
        ('forces', {'forces': {'y': '1'}}), ('forces.x', {'forces': {'x': True}}),
        ('forces.x', {'forces': {'x': [1.0]}}),
        ('joints', {'joints': ['slide']}), ('joints.1x', {'joints': {'1x': 'slide'}}),
        ('joints.x', {'joints': {'x': 3}}), ('joints.t', {'joints': {'x': 'slide', 't': 'slide'}}),
        ('joints.pi', {'joints': {'x': 'slide', 'pi': 'slide'}}),
        ('joints.sin', {'joints': {'x': 'slide', 'sin': 'slide'}}),
        ('rates.v', {'rates': {'v': 'y'}}), ('rates.x', {'rates': {'x': 'x'}}),
        ('distances.d', {'distances': {'d': ['center']}}),
        ('distances.d', {'distances': {'d': 'center'}}),
        ('components.c[1]', {'components': {'c': ['center', 'w']}}),
        ('components.c', {'components': {'c': 'center'}}),
        ('parameters.k', {'parameters': {'k': math.inf}}),
        ('parameters.x', {'parameters': {'x': 1.0}}),
        ('parameters', {'parameters': {f'k{n}': 1.0 for n in range(14)}}),
        ('states.x', {'states': {'x': '1'}}), ('start', {'start': {'z': 1.0}}),
        ('start.z', {'states': {'z': '1'}, 'start': {'z': 'a'}}),
        ('readings', {'readings': {f'r{n}': '1' for n in range(4)}})]),
    (MagneticSpring, {'point_a': 'center', 'strength': 1.0, 'size': 0.1}, [
        ('size', {'size': 0.0}), ('strength', {'strength': math.nan}),
        ('point_b', {'anchor': (0.0, 0.0), 'point_b': 'tip'})]),
    (Payload, {'body': 'rod', 'mass': 1.0}, [
        ('mass', {'mass': -1.0}), ('position', {'position': (0.0,)}),
        ('inertia', {'inertia': -0.1})]),
    (PointSpring, {'point_a': 'center'}, [
        ('point_b', {}), ('point_b', {'point_b': 'front', 'anchor': (0.0, 0.0)}),
        ('stiffness', {'point_b': 'front', 'stiffness': -1.0}), ('anchor', {'anchor': (0.0,)})]),
    (PrescribedForce, {}, [
        ('frequency', SINE), ('frequency', {**SINE, 'frequency': 0.0}),
        ('rise', {**STEP, 'rise': 1.0}), ('joint', {'shape': 'constant', 'amplitude': 1.0}),
        ('joint', {**AT_POINT, 'joint': 'slide'}), ('direction', AT_POINT),
        ('direction', {**AT_POINT, 'direction': (0, 0)}),
        ('shape', {'shape': 'wave', 'joint': 'slide'}), ('rise', {**TRAPEZOID, 'rise': -1.0}),
        ('fall', {**TRAPEZOID, 'fall': 1.0}),
        ('period', {**TRAPEZOID, 'hold': 1.0, 'period': 2.0}),
        ('times[1]', {**TABLE, 'times': (0.0, 0.0)}), ('values', {**TABLE, 'values': (0.0,)}),
        ('times', {**TABLE, 'times': (0.0,), 'values': (1.0,)}),
        ('times', {**TABLE, 'period': 2.0}),
        ('values[1]', {**TABLE, 'values': (0.0, math.nan)}),
        ('values[1]', {**TABLE, 'period': 1.0, 'interpolation': 'cubic'})]),
    (Rotor, {'joint': 'hinge', 'inertia': 1.0}, [
        ('inertia', {'inertia': -1.0}), ('gear_ratio', {'gear_ratio': 0.0})]),
    (Sensor, {}, [
        ('position_noise', {'position_noise': -1.0}), ('seed', {'seed': -1}),
        ('seed', {'seed': 1.5}), ('delay', {'delay': -0.1}),
        ('velocity_resolution', {'velocity_resolution': -1.0}),
        ('position_bias', {'position_bias': math.inf})]),
    (Tendon, {'arms': {'slide': 1.0}}, [
        ('arms', {'arms': {}}), ('arms', {'arms': 'slide'}),
        ('arms.slide', {'arms': {'slide': 'x'}}), ('stiffness', {'stiffness': 'x'}),
        ('stiffness[1]', {'stiffness': [1.0, None]}), ('damping[0]', {'damping': math.nan}),
        ('rest', {'rest': (1.0, 0.0)}), ('rest', {'rest': (1.0,)})]),
    (TendonFriction, {'arms': {'slide': 1.0}}, [
        ('coulomb', {'coulomb': -1.0}), ('arms', {'arms': {}}), ('coulomb', {'coulomb': 'x'})]),
    (TendonInertia, {'arms': {'slide': 1.0}}, [('inertia', {'inertia': -1.0})])]


@pytest.mark.parametrize('kind, key, values', [
    (kind, key, {**good, **changes}) for kind, good, faults in IMPOSSIBLE
    for key, changes in faults])
def test_what_cannot_be_is_refused_by_its_key(kind, key, values):
    with pytest.raises(FieldError) as refusal:
        kind(**values)
    assert str(refusal.value).startswith(f'{key}: expected'), refusal.value


SPACE, PLANE = point_mass, block
# What a machine does not have, or has of other dimensions.
UNFIT = [
    (SPACE, ExternalForce('center', (1.0, 2.0)), 'force: .*3 finite numbers'),
    (SPACE, ExternalForce('center', (1.0, 2.0, 3.0), 1.0), 'torque: .*3 finite numbers'),
    (SPACE, PointSpring('center', anchor=(0.0, 0.0)), 'anchor: .*3 finite numbers'),
    (SPACE, Contact('center', (0.0, 0.0, 0.0), 1.0), 'normal: .*normal .* got none'),
    (SPACE, Contact('center', (0.0, 0.0, 0.0), 1.0, angle=0.1, normal=(0.0, 0.0, 1.0)),
     'angle: .*no angle'),
    (SPACE, Payload('ball', 1.0, (0.0, 1.0)), 'position: .*3 finite numbers'),
    (SPACE, Bushing('center', anchor=(0.0, 0.0, 0.0), angle=0.1), 'angle: .*no such key in space'),
    (SPACE, Bushing('center', anchor=(0.0, 0.0, 0.0), damping=(1.0, 1.0)), 'damping: .*3 finite'),
    (SPACE, Cable(('center', 'center', 'center'), 1.0, 1.0, radii=(0.0, 0.1, 0.0)),
     'axis: .*the axis of pulleys that have a radius'),
    (SPACE, Payload('ball', 1.0, inertia=0.1), 'inertia: .*list of 3'),
    (PLANE, ExternalForce('center', (1.0, 2.0, 3.0)), 'force: .*2 finite numbers'),
    (PLANE, ExternalForce('center', torque=(1.0, 2.0, 3.0)), 'torque: .*a finite number'),
    (PLANE, Contact('center', (0.0, 0.0), 1.0, normal=(0.0, 1.0, 0.0)), 'normal: .*no normal'),
    (PLANE, Rotor('slide', 1.0, axis=(0.0, 0.0, 1.0)), 'axis: .*no axis'),
    (PLANE, Cable(('center', 'front', 'center'), 1.0, 1.0, radii=(0.0, 0.1, 0.0),
                  axis=(0.0, 0.0, 1.0)), 'axis: .*no axis in the plane'),
    (PLANE, Bushing('center', anchor=(0.0, 0.0), stiffness=(1.0, 1.0, 1.0)),
     'stiffness: .*2 finite'),
    (PLANE, Bushing('center', anchor=(0.0, 0.0), turning_stiffness=(1.0, 1.0, 1.0)),
     'turning_stiffness: .*one number'),
    (PLANE, Bushing('center', anchor=(0.0, 0.0), orientation=(0.0, 0.0, 1.0, 0.0)),
     'orientation: .*no such key in the plane'),
    (PLANE, Payload('block', 1.0, inertia=(0.1, 0.1, 0.1)), 'inertia: .*zero or more'),
    (PLANE, FluidDrag('center', turning_linear=(1.0, 1.0, 1.0)), 'turning_linear'),
    (PLANE, FluidDrag('center', linear=(1, 1, 1)), 'linear'),
    (PLANE, FluidDrag('center', orientation=(0.0, 0.0, 1.0, 0.0)), 'orientation'),
    (PLANE, JointDamping('slyde', 1.0), 'joint: .*slide.*slyde'),
    (PLANE, PointSpring('center', 'rear'), 'point_b: .*rear'),
    (PLANE, ExternalForce('rear'), 'point'), (PLANE, Tendon({'slid': 1.0}), 'arms: expected'),
    (PLANE, TendonFriction({'slid': 1.0}), 'arms: expected'),
    (PLANE, TendonInertia({'slid': 1.0}, 1.0), 'arms: expected'),
    (PLANE, PrescribedMotion('constant', joint='slyde'), 'joint'),
    (PLANE, PrescribedMotion('constant', point='frond', direction=(1.0, 0.0)), 'point'),
    (PLANE, PrescribedMotion('constant', point='front', direction=(1.0, 0.0, 0.0)), 'direction'),
    (PLANE, Cable(('center', 'tip'), 1.0, 1.0), r'points\[1\]'),
    (PLANE, Payload('bar', 1.0), 'body: .*bar'), (PLANE, Rotor('elbow', 1.0), 'joint'),
    (flyer, BodyContact('ball', 'rim', 'line', 1.0), 'another body')]


@pytest.mark.parametrize('machine, record, expected', UNFIT)
def test_what_does_not_fit_a_machine_is_refused(machine, record, expected):
    with pytest.raises(FieldError, match=rf'effects\.effect\b.*{expected}'):
        simulated(machine(), {'effect': record}, machine().coordinates.start())
