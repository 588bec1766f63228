# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Small models written for the tests, and what they are."""

from textwrap import indent

# mass, centre of mass, principal moments of the bars of a four-bar in the x-z plane.
BARS = {'crank': (0.5, 0.05, (1e-4, 5.5e-4, 6e-4)), 'coupler': (1.0, 0.2, (2e-4, 1.49e-2, 1.5e-2)),
        'rocker': (0.8, 0.15, (1.5e-4, 6.9e-3, 7e-3))}


def link(name, mass=None, place=0.0, inertia=None, rpy='0 0 0'):
    """Return a link of URDF."""
    if mass is None:
        return f'<link name="{name}"/>\n'
    xx, yy, zz = inertia
    return (f'<link name="{name}"><inertial><origin xyz="{place} 0 0" rpy="{rpy}"/>'
            f'<mass value="{mass}"/><inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" '
            'iyz="0"/></inertial></link>\n')


def joint(name, kind, parent, child, xyz='0 0 0', axis='0 1 0', inside=''):
    """Return a joint of URDF."""
    return (f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>{inside}</joint>\n')


def robot(*parts, name='four_bar'):
    """Return a URDF file, an element a line."""
    return f'<robot name="{name}">\n' + indent(''.join(parts), '  ') + '</robot>\n'


LINKS = link('base') + ''.join(link(name, *values) for name, values in BARS.items())
TREE = (joint('crank_joint', 'continuous', 'base', 'crank',
              inside='<limit effort="2" velocity="9"/>')
        + joint('coupler_joint', 'continuous', 'crank', 'coupler', '0.1 0 0')
        + joint('rocker_joint', 'continuous', 'base', 'rocker', '0.35 0 0'))
TIPS = (link('coupler_tip') + joint('coupler_end', 'fixed', 'coupler', 'coupler_tip', '0.4 0 0')
        + link('rocker_tip') + joint('rocker_end', 'fixed', 'rocker', 'rocker_tip', '0.3 0 0'))

# The same pin in every way of writing a loop, and its type in the mechanism.
LOOPS = {
    'loop': ('revolute', """\
<loop name="pin" type="continuous">
<predecessor link="coupler"><origin xyz="0.4 0 0"/></predecessor>
<successor link="rocker"><origin xyz="0.3 0 0"/></successor><axis xyz="0 1 0"/></loop>
"""),
    'constraint': ('revolute', """\
<constraint name="pin" type="revolute"><parent link="coupler"/><parent_origin xyz="0.4 0 0"/>
<parent_axis xyz="0 1 0"/><child link="rocker"/><child_origin xyz="0.3 0 0"/>
<child_axis xyz="0 1 0"/></constraint>
"""),
    'loop_joint': ('spherical', """\
<loop_joint name="pin" type="spherical"><link1 link="coupler" rpy="0 0 0" xyz="0.4 0 0"/>
<link2 link="rocker" rpy="0 0 0" xyz="0.3 0 0"/></loop_joint>
"""),
    'drake': ('spherical', """\
<drake:ball_constraint><drake:ball_constraint_body_A name="coupler"/>
<drake:ball_constraint_p_AP value="0.4 0 0"/><drake:ball_constraint_body_B name="rocker"/>
<drake:ball_constraint_p_BQ value="0.3 0 0"/></drake:ball_constraint>
"""),
}

# What other programs let act on bodies.
MOVING = ('<gazebo reference="crank"><velocity_decay><linear>0.2</linear><angular>0.5</angular>'
          '</velocity_decay></gazebo><gazebo><plugin name="sea" '
          'filename="gz-sim-hydrodynamics-system"/><plugin name="camera" filename="c.so"/>'
          '</gazebo><drake:linear_bushing_rpy><drake:bushing_torque_stiffness value="1 20 3"/>'
          '</drake:linear_bushing_rpy>\n')


def four_bar(way='loop'):
    """Return the URDF of a four-bar, its loop written in one of the ways."""
    return robot(LINKS, TREE, LOOPS[way][1])


# The same machine as a mechanism of our own.
MECHANISM = """\
name: four_bar
bodies:
  crank: {mass: 0.5, center_of_mass: [0.05, 0, 0], inertia: [1e-4, 5.5e-4, 6e-4]}
  coupler: {mass: 1, center_of_mass: [0.2, 0, 0], inertia: [2e-4, 1.49e-2, 1.5e-2]}
  rocker: {mass: 0.8, center_of_mass: [0.15, 0, 0], inertia: [1.5e-4, 6.9e-3, 7e-3]}
joints:
  crank_joint: {type: revolute, parent: ground, child: crank, position: [0, 0, 0], axis: [0, 1, 0],
                actuated: true}
  coupler_joint: {type: revolute, parent: crank, child: coupler, position: [0.1, 0, 0],
                  axis: [0, 1, 0]}
  rocker_joint: {type: revolute, parent: ground, child: rocker, position: [0.35, 0, 0],
                 axis: [0, 1, 0]}
cut_joints:
  pin: {type: TYPE, body_a: coupler, point_a: [0.4, 0, 0], body_b: rocker, point_b: [0.3, 0, 0]}
"""


def mechanism_text(kind):
    """Return the four-bar as a mechanism, its loop closed by a joint of a type."""
    axes = ', axis_a: [0, 1, 0], axis_b: [0, 1, 0]}' if kind == 'revolute' else '}'
    text = MECHANISM.replace('TYPE', kind)
    return text[:text.rindex('}')] + axes + '\n'


def written(tmp_path, text, name='robot.urdf'):
    """Write a file, and return its path."""
    path = tmp_path / name
    path.write_text(text)
    return path
