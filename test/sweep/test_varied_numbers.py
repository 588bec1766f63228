# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Simulations that take other numbers: what ones built of the changed scenes do, bit for bit."""

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.mechanism.config import shipped_names
from closedloop_dynamics.scene.key_paths import changed, numbers, resolve
from closedloop_dynamics.simulation.rollout_run import QUANTITIES
import numpy as np
import pytest

from ..reference import cases


def some_keys(scene, rng):
    """Return keys of bodies and effects, of each kind that the scene has."""
    found = {}
    for key, value in numbers(scene).items():
        section, *words = key.split('.')
        if value is not None and (section == 'effects' or words[0] == 'bodies'):
            kind = (section, next(word for word in reversed(words) if not word.isdigit()))
            found.setdefault(kind, []).append(key)
    return [str(rng.choice(keys)) for keys in found.values()]


def values_near(scene, key, rng, count):
    """Return values that a number may have, more or less."""
    value = numbers(scene)[key]
    return value * rng.uniform(0.8, 1.2, count) if value else rng.uniform(0.0, 0.05, count)


@pytest.fixture
def varied(monkeypatch):
    """Count how often numbers were taken in place."""
    taken = []
    vary = Simulation.vary

    def watched(self, scene):
        taken.append(vary(self, scene))
        return taken[-1]

    monkeypatch.setattr(Simulation, 'vary', watched)
    return taken


@pytest.mark.parametrize('name', cases.only(cases.CLASSES, shipped_names('scenes')))
def test_numbers_taken_in_place_are_those_of_a_scene_that_has_them(varied, name):
    scene, rng, count = load_scene(name), np.random.default_rng(7), 3
    simulation = Simulation(scene)
    torques = rng.normal(0.0, 1.0, (count, 3, len(simulation.actuated_joints)))
    for key in some_keys(scene, rng):
        # From others, which leave nothing behind.
        simulation.rollout(steps=3, threads=1, parameters={
            key: values_near(scene, key, rng, count)})
        values = values_near(scene, key, rng, count)
        found = simulation.rollout(
            torques, threads=1, quantities=QUANTITIES, parameters={key: values})
        for sample, value in enumerate(values):
            try:
                other = changed(scene, {resolve(scene, key): value})
                alone = Simulation(other).rollout(torques[sample], quantities=QUANTITIES)
                failure = alone.failures.get(0)
            except ValueError as error:
                failure = str(error)
            assert found.failures.get(sample) == failure, key
            if failure is None:
                for quantity in QUANTITIES:
                    np.testing.assert_array_equal(
                        getattr(found, quantity)[sample], getattr(alone, quantity)[0],
                        f'{key}: {quantity}')
    assert any(varied)


@pytest.mark.parametrize('name', ['three_rrr', 'stewart_platform', 'carpet_scraper_on_carpet'])
def test_errors_are_those_of_the_whole_scene(name):
    scene = load_scene(name)
    key = f'mechanism.bodies.{scene.mechanism.bodies[1].name}.mass'
    found = Simulation(scene).rollout(steps=2, threads=1, parameters={key: [1.0, -1.0, np.nan]})
    assert list(found.failures) == [1, 2]
    assert found.failures[1].startswith(f'mechanism {scene.mechanism.name!r}: {key[10:]}: ')
    assert found.failures[2].startswith(key) and 'finite' in found.failures[2]
