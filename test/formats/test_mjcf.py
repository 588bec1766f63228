# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""MJCF: the same closures as MuJoCo has them, and what is refused."""

from closedloop_dynamics import MechanismError, read_mechanism
from closedloop_dynamics.formats.building import lines
from closedloop_dynamics.formats.mjcf_omissions import FIELDS
from closedloop_dynamics.formats.registry import read_model
from closedloop_dynamics.formats.yaml_text import mechanism_text
from closedloop_dynamics.kinematics.global_assembly import ClosureProblem
from closedloop_dynamics.kinematics.modeling import build_model
import numpy as np
import pytest

from ..reference.loop_closure import coupling_errors
from ..reference.numbers import Numbers

mujoco = pytest.importorskip('mujoco')

# A tree of every joint, several in one body, offsets, ref, and all that acts on a joint.
TREE = """\
<mujoco model="tree">
  <compiler angle="degree" eulerseq="xyz"/>
  <option gravity="0.5 -1 -9"><flag contact="disable"/></option>
  <default><default class="light"><joint damping="0.05"/></default></default>
  <worldbody>
    <light pos="0 0 1"/>
    <body name="base" pos="0 0 1">
      <inertial pos="0.1 0 0" mass="3" fullinertia="0.1 0.12 0.14 0.01 0.005 -0.01"/>
      <freejoint name="drift"/>
      <body name="arm" pos="0.2 0.1 0" euler="10 20 30">
        <inertial pos="0.1 0.05 0" mass="1" diaginertia="0.01 0.02 0.02" euler="5 6 7"/>
        <joint name="slide" type="slide" axis="1 2 0" ref="0.1" stiffness="3" springref="0.2"/>
        <joint name="hinge" axis="0 1 1" pos="0.02 0.03 0" ref="-40" armature="0.2" class="light"
               range="-90 45"/>
        <geom size="0.1"/>
        <body name="hand" pos="0.3 0 0" quat="0.5 0.5 0.5 0.5">
          <inertial pos="0 0.1 0" mass="0.5" diaginertia="0.003 0.004 0.005"/>
          <joint name="ball" type="ball" pos="0.01 0 0"/>
        </body>
        <body name="plate" pos="0.2 0 0" euler="0 0 40">
          <geom type="box" size="0.1 0.02 0.03" pos="0.05 0 0" density="1000"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="hinge" gear="3"/></actuator>
</mujoco>
"""

LOOPS = """\
<mujoco model="loops">
  <worldbody>
    <body name="crank">
      <inertial pos="0.05 0 0" mass="0.5" diaginertia="1e-3 2e-3 2e-3"/>
      <joint name="a" axis="0 1 0"/>
      <body name="coupler" pos="0.1 0 0">
        <inertial pos="0.2 0 0" mass="1" diaginertia="1e-3 0.01 0.01"/>
        <joint name="b" axis="0 1 0" ref="30"/><site name="tip" pos="0.4 0 0"/></body>
    </body>
    <body name="rocker" pos="0.35 0 0">
      <inertial pos="0.1 0 0" mass="1" diaginertia="1e-3 0.01 0.01"/>
      <joint name="c" axis="0 1 0"/><site name="top" pos="0.3 0 0" euler="0 20 0"/></body>
    <body name="gear" pos="0 1 0"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <joint name="d" axis="0 1 0"/></body>
    <body name="lid" pos="0 2 0"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <joint name="e" type="ball"/></body>
  </worldbody>
  <tendon><fixed name="belt">
    <joint joint="a" coef="2"/><joint joint="d" coef="-1"/></fixed></tendon>
  <equality>
    EQUALITY
  </equality>
</mujoco>
"""
EQUALITIES = {
    'connect': '<connect body1="coupler" body2="rocker" anchor="0.4 0 0"/>',
    'connect_sites': '<connect site1="tip" site2="top"/>',
    'weld': '<weld body1="coupler" body2="lid" anchor="0.1 0.2 0.3" '
            'relpose="0.1 0 0.2 0.5 0.5 0.5 0.5"/>',
    'weld_sites': '<weld site1="top" site2="tip"/>',
    'joint': '<joint joint1="a" joint2="b" polycoef="0.1 -2 0 0 0"/>',
    'tendon': '<tendon tendon1="belt" polycoef="0.3 0 0 0 0"/>',
}


def written(tmp_path, text, name='model.xml'):
    path = tmp_path / name
    path.write_text(text)
    return path


def compiled_or_skipped(text):
    """Return what MuJoCo makes of a file, if this version does."""
    try:
        return mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        pytest.skip(f'this version of MuJoCo does not have it: {error}')


def state(compiled, imported, rng):
    """Return MuJoCo's data in a state, and our coordinates and rates in the same."""
    coordinates = imported.mechanism.coordinates
    data = mujoco.MjData(compiled)
    q = ClosureProblem(imported.mechanism, 1.0).start(imported.position)
    qd = rng.normal(size=coordinates.nv)
    q = coordinates.moved(q, 0.5 * rng.normal(size=coordinates.nv))
    for number in range(compiled.njnt):
        name = compiled.joint(number).name
        own, rates = coordinates.coordinates[name], coordinates.rates[name]
        address, dof = compiled.jnt_qposadr[number], compiled.jnt_dofadr[number]
        values = q[own].copy()
        if len(values) >= 4:
            values[-4:] = values[[-1, -4, -3, -2]]
        if len(values) == 7:
            values[:3] += compiled.qpos0[address:address + 3]
        data.qpos[address:address + len(values)] = values
        data.qvel[dof:dof + rates.stop - rates.start] = qd[rates]
    mujoco.mj_forward(compiled, data)
    return data, q, qd


def of_mujoco(compiled, data, imported):
    """Return MuJoCo's accelerations in the order of our freedoms."""
    found = np.empty(compiled.nv)
    for number in range(compiled.njnt):
        rates = imported.mechanism.coordinates.rates[compiled.joint(number).name]
        dof = compiled.jnt_dofadr[number]
        found[rates] = data.qacc[dof:dof + rates.stop - rates.start]
    return found


BALL = '<joint name="ball" type="ball" pos="0.01 0 0"'
# A file with much that is left out, or read by special ways.
FULL = TREE.replace('<actuator>', """
  <tendon><fixed name="belt" stiffness="30" damping="0.5" frictionloss="2" limited="true"
  range="0 1"><joint joint="hinge" coef="2"/></fixed></tendon>
  <actuator><motor name="pull" tendon="belt" gear="10"/><plugin plugin="p" joint="slide"/>
  """).replace('<option ', '<option density="1.2" viscosity="2e-5" ').replace(
      '<body name="hand"', '<body gravcomp="1" name="hand"').replace(
      '</worldbody>', '<replicate count="2" offset="1 0 0"><body><joint/><geom size="0.1"/></body>'
      '</replicate></worldbody>').replace(
      '</mujoco>', '<keyframe><key name="start" qpos="0 0 0 1 0 0 0 0 0 1 0 0 0 0 0"/>'
      '</keyframe></mujoco>')


def test_flags_disable_equalities_drives_friction_and_limits(tmp_path):
    text = LOOPS.replace('EQUALITY', EQUALITIES['connect']).replace(
        '<joint name="a"', '<joint name="a" range="-50 50" frictionloss="2"').replace(
        '<tendon>', '<actuator><motor joint="a"/></actuator><tendon>')
    found = read_model(written(tmp_path, text))
    assert found.mechanism.cut_joints and found.mechanism.actuated_joints == ('a',)
    assert found.limits and 'friction_a' in found.effects
    flags = ('equality', 'actuation', 'frictionloss', 'limit')
    for flag in (*flags, 'constraint'):
        found = read_model(written(tmp_path, text.replace(
            '<worldbody>', f'<option><flag {flag}="disable"/></option><worldbody>')))
        left = (bool(found.mechanism.cut_joints), bool(found.mechanism.actuated_joints),
                'friction_a' in found.effects, bool(found.limits))
        assert left == tuple(flag != other and (flag != 'constraint' or other == 'actuation')
                             for other in flags)
        assert ('1 equalities' in found.ignored) != left[0]


def test_what_moves_bodies_and_is_left_out_is_named_with_its_size(tmp_path):
    text = TREE.replace('<actuator>', """
      <tendon><fixed name="belt" limited="true" range="0 1"><joint joint="hinge" coef="2"/></fixed>
      <spatial name="cord" armature="0.2" frictionloss="2"><site site="hook"/><site site="eye"/>
      </spatial></tendon>
      <actuator><motor name="pull" tendon="belt" gear="10"/>""").replace(
        BALL, f'{BALL} stiffness="0 4"')
    for before, name in (('<light', 'hook'), (BALL, 'eye')):
        text = text.replace(before, f'<site name="{name}"/>{before}')
    imported = read_model(written(tmp_path, text))
    assert [(one.quantity, one.kind, one.name, one.size, one.unit)
            for one in sorted(imported.omitted, key=lambda one: -one.size)] == [
        ('higher terms of the stiffness', 'joint', 'ball', 4.0, 'N m/rad^2'),
        ('friction', 'tendon', 'cord', 2.0, 'N'), ('armature', 'tendon', 'cord', 0.2, 'kg')]
    assert imported.ignored['limits of 1 tendon(s)'] == 'no end stops unless they are asked for'
    notes = lines(imported, 1.0)
    assert notes[0] == (
        'left out of the motion, springs and dampers are linear: higher terms of the stiffness of '
        'joint ball (4 N m/rad^2)')
    assert notes[1] == (
        'left out of the motion, no effect acts along such tendons: friction of tendon cord '
        '(2 N); armature of tendon cord (0.2 kg)')
    # What turns counts as the force that it makes at the size of the machine.
    assert 'friction' in lines(imported, 2.1)[0]
    # What has no influence on the motion comes last.
    assert 'pictures' in notes[-1] and 'pictures' not in ''.join(notes[:-1])


def test_gains_of_actuators_are_left_out_by_name_and_size(tmp_path):
    text = TREE.replace('<actuator>', """<actuator>
      <position name="servo" joint="hinge" kp="20" kv="0.5" gear="3"/>
      <velocity name="pump" joint="slide" kv="7"/>""")
    for flags, expected in (('', [
            ('position gain', 'actuator', 'servo', 180.0, 'N m/rad'),
            ('velocity gain', 'actuator', 'pump', 7.0, 'N s/m'),
            ('velocity gain', 'actuator', 'servo', 4.5, 'N m s/rad')]),
            ('<option><flag actuation="disable"/></option>', [])):
        imported = read_model(written(
            tmp_path, text.replace('<worldbody>', f'{flags}<worldbody>')))
        assert [(one.quantity, one.kind, one.name, one.size, one.unit)
                for one in sorted(imported.omitted, key=lambda one: -one.size)] == expected
    assert not [note for note in lines(imported, 1.0) if 'gain' in note and 'motion' in note]


def test_bodies_without_names_are_drawn_too(tmp_path):
    body = ('<body pos="0 0 {}"><joint name="{}" axis="0 1 0"/>'
            '<geom size="0.1"/></body>')
    text = ('<mujoco><worldbody><body name="body_3"><joint name="a"/><geom size="0.3"/></body>'
            '<replicate count="2" offset="1 0 0">' + body.format(0, 'b') + '</replicate>'
            + body.format(1, 'c') + '<body name="ground"><joint name="d"/><geom size="0.2"/>'
            '</body></worldbody></mujoco>')
    imported = read_model(written(tmp_path, text))
    sizes = {body.name: body.visual[0].size for body in imported.mechanism.bodies}
    assert sizes == {'body_3': (0.3,), 'body_2_0': (0.1,), 'body_2_1': (0.1,), 'body_3_': (0.1,),
                     'ground_link': (0.2,)}
    assert imported.ignored['the name ground of a link, ground_link taken'] == (
        'ground is the world')


def test_names_that_are_made_up_are_none_of_the_file(tmp_path):
    part = '<body name="{}"><joint{}/><joint axis="1 0 0"/><geom size="0.1"/></body>'
    text = ('<mujoco><worldbody>' + part.format('a', '') + part.format('a_1', ' name="a_joint_2"')
            + '<body name="a_fixed"><joint name="a_1_joint_2"/><geom size="0.1"/></body>'
            '</worldbody></mujoco>')
    mechanism = read_model(written(tmp_path, text)).mechanism
    assert mechanism.joint_names == (
        'a_joint_1', 'a_joint_2_', 'a_joint_2', 'a_1_joint_2_', 'a_1_joint_2')
    assert [body.name for body in mechanism.bodies] == ['a', 'a_1_', 'a_1', 'a_1_1', 'a_fixed']


def test_warnings_of_mujoco_are_reported_and_write_no_file(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    part = ('<mujoco model="part"><option timestep="0.01"/><worldbody><body name="b"><joint/>'
            '<geom size="0.1"/></body></worldbody></mujoco>')
    written(tmp_path, part, 'part.xml')
    text = ('<mujoco><asset><model name="part" file="part.xml"/></asset><worldbody><body>'
            '<attach model="part" body="b" prefix="p"/></body></worldbody></mujoco>')
    before = mujoco.get_mju_user_warning()
    ignored = read_model(written(tmp_path, text)).ignored
    assert mujoco.get_mju_user_warning() is before
    assert {path.name for path in tmp_path.iterdir()} == {'model.xml', 'part.xml'}
    assert not capfd.readouterr().err
    reported = {text for text, why in ignored.items() if why == 'a warning of MuJoCo'}
    # Older versions say nothing of it.
    assert not reported or any('timestep' in text for text in reported)


def test_actuators_of_several_outputs(tmp_path):
    if not hasattr(mujoco.mjtTrn, 'mjTRN_SO3'):
        pytest.skip('this version of MuJoCo has none')
    text = TREE.replace('<actuator>', '<actuator><orientation joint="ball"/>')
    imported = read_model(written(tmp_path, text))
    assert imported.mechanism.actuated_joints == ('hinge', 'ball.rx', 'ball.ry', 'ball.rz')


@pytest.mark.parametrize('kind', EQUALITIES)
def test_equalities_are_open_as_mujoco_finds_them(tmp_path, kind):
    text = LOOPS.replace('EQUALITY', EQUALITIES[kind])
    compiled, imported = mujoco.MjModel.from_xml_string(text), read_model(written(tmp_path, text))
    loops, rng = ClosureProblem(imported.mechanism, 1.0), np.random.default_rng(1)
    if kind == 'connect':
        # As it is drawn, MuJoCo finds the second anchor where the first is.
        cut = imported.mechanism.cut_joints[0]
        assert cut.point_a == (0.4, 0.0, 0.0)
    for _ in range(3):
        data, q, _ = state(compiled, imported, rng)
        ours, unit = loops.residual(q)[0], 1.0
        for coupling in imported.mechanism.couplings:
            unit = max(map(abs, coupling.joints.values()))
        assert unit * np.linalg.norm(ours[:3]) == pytest.approx(
            np.linalg.norm(data.efc_pos[:3]), rel=1e-9)
        if kind.startswith('weld'):
            # What the cosines of three pairs of axes lack of 1: 4 sin(angle / 2) ** 2.
            assert np.linalg.norm(data.efc_pos[3:6]) == pytest.approx(
                0.5 * np.sqrt(ours[-1]), rel=1e-9)


def test_a_polynomial_between_joints_is_open_as_mujoco_finds_it(tmp_path):
    text = LOOPS.replace(
        'EQUALITY', '<joint joint1="b" joint2="a" polycoef="0.1 -2 0.5 0.3 -0.2"/>').replace(
            '<joint name="a"', '<joint ref="20" name="a"')
    compiled, imported = mujoco.MjModel.from_xml_string(text), read_model(written(tmp_path, text))
    assert not imported.omitted
    rng = np.random.default_rng(1)
    for _ in range(3):
        data, q, qd = state(compiled, imported, rng)
        assert coupling_errors(imported.mechanism, q)[0] == pytest.approx(
            data.efc_pos[0], rel=1e-12)
        numbers = Numbers(build_model(imported.mechanism, (0.0, 0.0, -9.81)))
        numbers.move(q, qd)
        rate = np.zeros(data.nefc)
        mujoco.mj_mulJacVec(compiled, data, rate, data.qvel)
        assert (numbers.jacobian() @ qd)[0] == pytest.approx(rate[0], rel=1e-12)


@pytest.mark.parametrize('kind', ['weld', 'weld_sites'])
def test_a_weld_whose_torques_count_nothing_is_a_ball(tmp_path, kind):
    text = LOOPS.replace('EQUALITY', EQUALITIES[kind].replace('/>', ' torquescale="0"/>'))
    compiled, imported = mujoco.MjModel.from_xml_string(text), read_model(written(tmp_path, text))
    assert [cut.type for cut in imported.mechanism.cut_joints] == ['spherical']
    loops, rng = ClosureProblem(imported.mechanism, 1.0), np.random.default_rng(1)
    data, q, _ = state(compiled, imported, rng)
    assert not data.efc_pos[3:6].any()
    assert np.linalg.norm(loops.residual(q)[0]) == pytest.approx(
        np.linalg.norm(data.efc_pos[:3]), rel=1e-9)


def test_what_acts_is_read_and_the_rest_is_reported(tmp_path):
    imported = read_model(written(tmp_path, TREE))
    assert imported.mechanism.actuated_joints == ('hinge',)
    assert imported.effects['gravity']['acceleration'] == (0.5, -1.0, -9.0)
    assert set(imported.effects) == {'gravity', 'stiffness_slide', 'damping_hinge',
                                     'armature_hinge'}
    assert imported.limits == {'hinge': pytest.approx((-np.pi / 2, np.pi / 4))}
    assert imported.position == {'slide': pytest.approx(0.1), 'hinge': pytest.approx(-0.69813170)}
    assert imported.ignored['light'] == 'for pictures'
    assert 'touch' not in ''.join(imported.ignored)


@pytest.mark.parametrize('option, second, count', [
    ('', '', 3), ('', 'contype="0" conaffinity="0"', 2), ('', 'contype="2" conaffinity="2"', 2),
    ('<option><flag contact="disable"/></option>', '', 0)])
def test_contacts_are_left_out_with_the_number_of_shapes(tmp_path, option, second, count):
    # Those that masses follow from count, those beside an inertia, and the ground.
    text = (f'<mujoco model="m">{option}<worldbody><geom type="plane" size="1 1 1" '
            'conaffinity="0"/><body><freejoint/><geom size="0.1"/></body><body><inertial '
            'pos="0 0 0" mass="1" diaginertia="1 1 1"/><freejoint/>'
            f'<geom size="0.1" {second}/></body></worldbody></mujoco>')
    ignored = read_model(written(tmp_path, text)).ignored
    assert [what for what, why in ignored.items() if why == 'bodies pass through each other'] == (
        [f'contacts of {count} shapes'] if count else [])


def test_includes_are_read_from_the_folder_only(tmp_path):
    inside = tmp_path / 'inside'
    inside.mkdir()
    body = '<body><joint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
    written(inside, f'<mujocoinclude>{body}</mujocoinclude>', 'part.xml')
    text = '<mujoco><worldbody><include file="{}"/></worldbody></mujoco>'
    assert read_model(written(inside, text.format('part.xml'))).mechanism.joint_names == (
        'body_1_joint_1',)
    written(tmp_path, f'<mujocoinclude>{body}</mujocoinclude>', 'outside.xml')
    written(inside, '<mujocoinclude><include file="b.xml"/></mujocoinclude>', 'a.xml')
    written(inside, '<mujocoinclude><include file="a.xml"/></mujocoinclude>', 'b.xml')
    for file, said in (('../outside.xml', 'expected a file in the folder of the model or below'),
                       ('a.xml', 'expected files that do not include themselves'),
                       ('none.xml', 'none.xml: expected a file that can be read')):
        with pytest.raises(MechanismError, match=said):
            read_model(written(inside, text.format(file)))


def test_meshes_are_needed_for_masses_only(tmp_path):
    asset = '<asset><mesh name="m" file="m.stl"/></asset>'
    geom = '<geom type="mesh" mesh="m"/>'
    heavy = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    text = (f'<mujoco>{asset}<worldbody><body><joint name="j"/>{geom}BODY</body></worldbody>'
            '</mujoco>')
    assert read_model(written(tmp_path, text.replace('BODY', heavy))).mechanism.bodies[0].mass == 1
    with pytest.raises(MechanismError, match='m.stl: expected a file that can be read'):
        read_model(written(tmp_path, text.replace('BODY', '')))


DRAWN = """\
<mujoco>
  <compiler meshdir="parts"/>
  <default><default class="seen"><geom group="2" rgba="0.1 0.2 0.3 1"/></default>
  <default class="contacts"><geom group="3"/></default></default>
  <asset>
    <texture name="wood" type="2d" file="wood.png"/><material name="red" rgba="1 0 0 1"/>
    <material name="wooden" texture="wood" rgba="0.5 0.4 0.2 1"/>
    <mesh name="cover" file="cover.obj" scale="2 2 2"/><hfield name="hill" file="hill.png"
    size="1 1 1 1"/>
  </asset>
  <worldbody>
    <geom type="plane" size="1 2 0.1" pos="0 0 -1"/><geom type="hfield" hfield="hill"/>
    <body name="foot" pos="0 0 0.1"><geom type="box" size="0.1 0.2 0.3" material="red"/>
    <body name="arm" pos="1 0 0"><joint name="j" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <geom class="seen" type="capsule" size="0.1" fromto="0 0 0 0 0 1"/>
      <geom class="contacts" type="sphere" size="0.5"/>
      <geom class="seen" type="mesh" mesh="cover" pos="0 0 0.5" euler="90 0 0" material="wooden"/>
      <geom type="cylinder" size="0.1 0.4"/><geom type="sphere" size="0.2" rgba="1 1 1 0"/>
      <geom type="ellipsoid" size="0.1 0.2 0.3"/></body></body>
  </worldbody>
</mujoco>
"""


def test_bodies_and_the_world_are_drawn_as_mujoco_draws_them(tmp_path):
    imported = read_model(written(tmp_path, DRAWN))
    plane, box = imported.mechanism.ground_visual
    assert (plane.kind, plane.size[:2], plane.color) == ('box', (2.0, 4.0), None)
    # The upper side is the plane.
    assert plane.center[2] + 0.5 * plane.size[2] == pytest.approx(-1.0)
    # What is fixed to the ground is drawn with it.
    assert (box.size, box.center, box.color) == (
        (0.2, 0.4, 0.6), (0.0, 0.0, 0.1), (1.0, 0.0, 0.0))
    rod, end, start, mesh, cylinder = imported.mechanism.bodies[0].visual
    assert (rod.kind, rod.size, rod.center) == ('cylinder', (0.1, 1.0), (0.0, 0.0, 0.5))
    assert {end.center[2], start.center[2]} == {0.0, 1.0} and end.kind == 'sphere'
    assert rod.color == end.color == (0.1, 0.2, 0.3)
    assert (mesh.file, mesh.size) == (
        str(tmp_path.resolve() / 'parts/cover.obj'), (2.0, 2.0, 2.0))
    assert mesh.orientation == pytest.approx((np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)))
    assert mesh.color == (0.5, 0.4, 0.2)
    assert (cylinder.size, cylinder.color) == ((0.1, 0.8), None)
    assert imported.ignored['pictures of kind ellipsoid'] == 'not drawn'
    # As a file, and read again.
    text = mechanism_text(imported.mechanism)
    again = read_mechanism(written(tmp_path, text, 'again.yaml'))
    assert again.ground_visual == imported.mechanism.ground_visual
    assert [one.color for one in again.bodies[0].visual] == [
        one.color for one in imported.mechanism.bodies[0].visual]


@pytest.mark.parametrize('number', ['nan', '1e999', '-inf'])
def test_numbers_that_mujoco_might_compute_on_without_an_end_are_refused(tmp_path, number):
    text = ('<mujoco><worldbody>\n<body><joint/><inertial pos="0 0 0" mass="1" '
            f'fullinertia="{number}"/></body></worldbody></mujoco>')
    with pytest.raises(MechanismError, match=(
            rf':2: <inertial>: expected fullinertia to be finite, got .{number}')):
        read_model(written(tmp_path, text))


def test_what_mujoco_refuses_is_reported(tmp_path):
    for text, said in (
            ('<mujoco><worldbody><body><joint/></body></worldbody></mujoco>', 'mass and inertia'),
            ('<mujoco><worldbody><x/></worldbody></mujoco>', 'x')):
        with pytest.raises(MechanismError, match=f'expected a model that MuJoCo compiles.*{said}'):
            read_model(written(tmp_path, text))


ARM = ('<mujoco model="arm"><compiler angle="radian" meshdir="m"/><asset><mesh name="rock" '
       'file="rock.obj"/></asset><worldbody><body name="arm"><joint name="j" range="-1 2"/>'
       '<geom type="mesh" mesh="rock"/><body><joint name="k"/><geom size="0.1"/></body></body>'
       '</worldbody></mujoco>')
ROCK = 'v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n'
TWO = ('<mujoco><asset><model name="arm" file="FILE"/></asset><worldbody><body name="base">'
       '<joint name="turn"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
       '<frame pos="1 0 0"><attach model="arm" body="arm" prefix="left_"/></frame>'
       '<frame pos="-1 0 0"><attach model="arm" body="arm" prefix="right_"/></frame></body>'
       '</worldbody></mujoco>')


def test_models_that_are_attached_and_files_from_anywhere(tmp_path):
    for folder in (tmp_path / 'robot' / 'm', tmp_path / 'm'):
        folder.mkdir(parents=True)
        written(folder, ROCK, 'rock.obj')
    written(tmp_path / 'robot', ARM, 'arm.xml')
    path = written(tmp_path / 'robot', TWO.replace('FILE', 'arm.xml'), 'two.xml')
    imported = read_model(path)
    assert imported.mechanism.joint_names == (
        'turn', 'left_j', 'left_k', 'right_j', 'right_k')
    assert [joint.parent for joint in imported.mechanism.joints] == [
        'ground', 'base', 'left_arm', 'base', 'right_arm']
    assert imported.limits['left_j'] == (-1.0, 2.0)
    rock = 1000.0 / 6.0
    assert imported.mechanism.bodies[1].mass == pytest.approx(rock)
    # Another mesh of the same name in another folder is no other file's.
    other = tmp_path / 'robot' / 'other'
    (other / 'm').mkdir(parents=True)
    written(other / 'm', ROCK.replace('1 0 0', '2 0 0'), 'rock.obj')
    written(other, ARM.replace('"arm"', '"odd"'), 'odd.xml')
    both = TWO.replace('FILE"/>', 'arm.xml"/><model name="odd" file="other/odd.xml"/>')
    with pytest.raises(MechanismError, match="expected another name for another file, got 'rock"):
        read_model(written(tmp_path / 'robot', both, 'both.xml'))
    # From outside of the folder only where that is asked for.
    for text, file in ((TWO.replace('FILE', '../arm.xml'), 'arm.xml'),
                       (ARM.replace('"m"', '"../m"'), 'rock.obj'),
                       ('<mujoco><include file="../arm.xml"/></mujoco>', 'arm.xml')):
        written(tmp_path, ARM, 'arm.xml')
        path = written(tmp_path / 'robot', text, 'outside.xml')
        with pytest.raises(MechanismError, match=(
                f'in the folder of the model or below, got .*{file}.*--anywhere')):
            read_model(path)
        if 'include' not in text:
            assert read_model(path, anywhere=True).mechanism.bodies[-1].mass > 1.0


def test_what_programs_drive_and_muscles_are_no_obstacle(tmp_path):
    text = ('<mujoco><extension><plugin plugin="nowhere.known"/></extension><worldbody>'
            '<geom name="post" type="cylinder" size="0.1 1" pos="0.3 0 1"/>'
            '<site name="a" pos="0 0 1"/><body name="b"><joint name="j" axis="0 1 0"/>'
            '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><site name="c" pos="1 0 0"/>'
            '<plugin plugin="nowhere.known"/></body></worldbody>'
            '<tendon><spatial name="t"><site site="a"/><geom geom="post"/><site site="c"/>'
            '</spatial></tendon>'
            '<actuator><plugin name="p" joint="j" plugin="nowhere.known"/>'
            '<muscle tendon="t"/></actuator></mujoco>')
    imported = read_model(written(tmp_path, text))
    assert imported.mechanism.actuated_joints == ('j',)
    assert imported.ignored['2 plugin'] == 'forces of programs'


# Of the families of numbers that move bodies: those that are read ...
READ = """
body_gravcomp body_inertia body_ipos body_iquat body_jntadr body_jntnum body_mass body_parentid
body_plugin body_pos body_quat jnt_axis jnt_dofadr jnt_limited jnt_pos jnt_qposadr jnt_range
jnt_stiffness jnt_type dof_armature dof_damping dof_frictionloss dof_jntid actuator_armature
actuator_damping actuator_gear actuator_outadr actuator_trnid actuator_trntype tendon_adr
tendon_limited tendon_num eq_active0 eq_data eq_obj1id eq_obj2id eq_objtype eq_type"""
# ... those of drives, whose commands are efforts here, and of limits of efforts ...
OF_DRIVES = """
jnt_actfrclimited jnt_actfrcrange jnt_actgravcomp jnt_actuatorid tendon_actfrclimited
tendon_actfrcrange tendon_actuatorid actuator_actlimited actuator_actrange actuator_actearly
actuator_actnum actuator_actadr actuator_biasprm actuator_biastype actuator_cranklength
actuator_ctrladr actuator_ctrllimited actuator_ctrlnum actuator_ctrlrange actuator_ctrlspec
actuator_delay actuator_dynprm actuator_dyntype actuator_forcelimited actuator_forcerange
actuator_gainprm actuator_gaintype actuator_history actuator_historyadr actuator_lengthrange
actuator_outnum actuator_plugin"""
# ... and those that follow from others, are of contacts, of pictures, or of MuJoCo's solver.
OTHERS = """
body_bvhadr body_bvhnum body_conaffinity body_contype body_dofadr body_dofnum body_geomadr
body_geomnum body_invweight0 body_margin body_mocapid body_rootid body_sameframe body_simple
body_subtreemass body_treeid body_user body_weldid jnt_bodyid jnt_group jnt_margin jnt_plasticadr
jnt_solimp jnt_solref jnt_user dof_M0 dof_Madr dof_bodyid dof_invweight0 dof_length dof_parentid
dof_simplenum dof_solimp dof_solref dof_treeid actuator_acc0 actuator_group actuator_length0
actuator_user tendon_group tendon_invweight0 tendon_length0 tendon_lengthspring tendon_margin
tendon_matid tendon_plasticadr tendon_range tendon_rgba tendon_solimp_fri tendon_solimp_lim
tendon_solref_fri tendon_solref_lim tendon_treeid tendon_treenum tendon_type tendon_user
tendon_width eq_solimp eq_solref"""


def test_every_number_of_the_compiled_model_that_moves_bodies_is_on_the_list():
    if not mujoco.mj_versionString().startswith('4.0'):
        pytest.skip('the list is that of MuJoCo 4.0')
    families = ('body', 'jnt', 'dof', 'actuator', 'tendon', 'eq')
    model = mujoco.MjModel.from_xml_string(TREE)
    known = [set(some.split()) for some in (READ, OF_DRIVES, OTHERS)] + [set(FIELDS)]
    for name in dir(model):
        if name.startswith(tuple(f'{one}_' for one in families)):
            assert sum(name in some for some in known) == 1, name
    assert set.union(*known) <= set(dir(model))


def test_friction_of_what_floats_acts_along_the_axes_of_the_world(tmp_path):
    text = TREE.replace('<freejoint name="drift"/>',
                        '<joint type="free" name="drift" frictionloss="0.5"/>')
    found = read_model(written(tmp_path, text))
    assert not found.omitted
    assert [name for name in found.effects if name.startswith('friction')] == [
        f'friction_drift_{name}' for name in ('x', 'y', 'z', 'rx', 'ry', 'rz')]
    turned = read_model(written(tmp_path, text.replace(
        '<body name="base" pos="0 0 1">', '<body name="base" pos="0 0 1" euler="10 0 0">')))
    omission, = turned.omitted
    assert (omission.quantity, omission.name, omission.size) == ('friction', 'drift', 0.5)
    assert not any(name.startswith('friction') for name in turned.effects)


def test_effects_of_names_that_look_alike(tmp_path):
    text = TREE.replace(BALL, f'{BALL} damping="0.7"').replace(
        '<joint name="slide"', '<joint name="ball_rx" axis="1 0 0" damping="3"/>'
        '<joint name="slide"')
    effects = read_model(written(tmp_path, text)).effects.values()
    assert {(one['joint'], one['coefficient']) for one in effects
            if one['type'] == 'joint_damping'} == {
        ('ball_rx', 3.0), ('hinge', 0.05), ('ball.rx', 0.7), ('ball.ry', 0.7), ('ball.rz', 0.7)}
