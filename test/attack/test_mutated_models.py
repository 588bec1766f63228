# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Damaged models in other formats: refused in words, or right; never a traceback.

Seeded; a few hundred of each, thousands with ``--all``. Counts are printed (``-s`` shows them).
"""

from collections import Counter
import re

from closedloop_dynamics import MechanismError, read_mechanism
from closedloop_dynamics.formats.registry import read_model
from closedloop_dynamics.formats.yaml_text import mechanism_text
import numpy as np
import pytest

from .test_mutated_scenes import mutated, put, reported, swap, WORD
from ..formats import machines, test_programs, test_sdf
try:
    from ..formats import test_mjcf, test_mjcf_forces
except pytest.skip.Exception:
    test_mjcf = None

VALUES = ('"1e999"', '"-1"', '"nan"', '"0"', '""', '"1e-320"', '"1 2"', '"1 2 3 4"', '"ground"',
          '"base"', '"pin"', '"../x"', '"&lt;"', '"&x;"', '"&#0;"', '"' + 9 * '9' * 99 + '"')
ATTRIBUTE = re.compile(r'"[^"<>]*"')
ELEMENT = re.compile(r'<[a-z_:A-Z]+[^<>]*/>|<([a-z_:A-Z]+)[^<>]*>[^<>]*</\1>')
DRAWN = ('<visual><origin xyz="0 0 1"/><geometry><mesh filename="package://m/a.stl" '
         'scale="1 1 1"/></geometry></visual><visual><geometry><cylinder radius="0.1" '
         'length="0.5"/></geometry></visual>')
DRAWN_IN_SDF = ('<visual name="v"><pose>0 0 1 0 0 0</pose><geometry><mesh><uri>model://m/a.stl'
                '</uri></mesh></geometry></visual><visual name="w"><geometry><box><size>1 1 2'
                '</size></box></geometry></visual>')
# Joints of SDF in URDF, and what Gazebo says of links and joints.
GAZEBO = ('<gazebo><frame name="top" attached_to="rocker"><pose>0.3 0 0 0 0 0</pose></frame>'
          '<joint name="pin" type="revolute"><parent>coupler</parent><child>top</child><axis>'
          '<xyz expressed_in="crank">0 1 0</xyz><dynamics><damping>0.2</damping></dynamics></axis>'
          '</joint></gazebo><gazebo reference="crank"><turnGravityOff>true</turnGravityOff>'
          '</gazebo><gazebo reference="crank_joint"><springStiffness>3</springStiffness></gazebo>')
FILES = {'urdf': [*(machines.four_bar(way) for way in machines.LOOPS),
                  machines.four_bar().replace('<inertial>', f'{DRAWN}<inertial>'),
                  machines.robot(machines.LINKS, machines.TREE, GAZEBO),
                  machines.robot(machines.LINKS, machines.TREE, machines.LOOPS['loop'][1],
                                 machines.MOVING),
                  machines.robot(machines.LINKS, test_programs.CLOSED, test_programs.PIN,
                                 f'<gazebo>{test_programs.DETACHABLE}</gazebo>',
                                 test_programs.MIMIC),
                  machines.robot(machines.LINKS, machines.TREE, test_programs.LINK,
                                 test_programs.PARAMETERS)],
         'sdf': [test_sdf.FOUR_BAR, test_sdf.FOUR_BAR.replace(
             '<inertial>', f'{DRAWN_IN_SDF}<inertial>'),
             test_sdf.nested(test_sdf.ARM.replace('POSE', test_sdf.RAISED).replace(
                 'EXPRESSED', 'expressed_in="__model__"')), test_programs.TWO_FRAMES],
         'mjcf': [test_mjcf.TREE, test_mjcf.LOOPS.replace(
             'EQUALITY', '\n'.join(test_mjcf.EQUALITIES.values())),
             test_mjcf.FULL, test_mjcf_forces.ALONG] if test_mjcf else []}


def damaged(rng, text):
    """Return a model with one to three damages, as bytes."""
    if rng.random() < 0.4:
        return mutated(rng, text)
    for _ in range(rng.integers(1, 4)):
        kind = rng.integers(4)
        if kind == 0:
            text = put(rng, text, ATTRIBUTE, str(rng.choice(VALUES)))
        elif kind == 1:
            text = swap(rng, text, ATTRIBUTE)
        elif kind == 2:
            text = swap(rng, text, ELEMENT if rng.random() < 0.7 else WORD)
        else:
            text = put(rng, text, ELEMENT, '')
    return text.encode()


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('kind', [kind for kind, files in FILES.items() if files])
@pytest.mark.parametrize('count', [80, pytest.param(3000, marks=pytest.mark.slow)])
def test_damaged_models_are_refused_in_words_or_right(tmp_path, kind, count):
    rng, counts, bad = np.random.default_rng(20261122), Counter(tried=count), []
    path, again = tmp_path / f'model.{kind}', tmp_path / 'again.yaml'
    for number in range(count):
        content = damaged(rng, FILES[kind][number % len(FILES[kind])])
        path.write_bytes(content)
        try:
            mechanism = read_model(path).mechanism
            again.write_text(mechanism_text(mechanism), encoding='utf-8')
            right = read_mechanism(again) == mechanism
            outcome = 'accepted' if right else 'silent'
        except MechanismError as error:
            outcome = 'clean errors' if str(error).startswith(str(path)) else 'silent'
        except Exception as error:
            outcome = 'tracebacks'
            bad.append(f'{number}: {type(error).__name__}: {error}')
        counts[outcome] += 1
        if outcome == 'silent':
            bad.append(f'{number}: {content!r}')
    reported(counts)
    assert not bad, '\n'.join(bad)
    assert min(counts['clean errors'], counts['accepted']) > 0.05 * count
