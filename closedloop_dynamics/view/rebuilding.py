# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Machines built from a scene that is edited, at once or beside the one before, which moves on."""

from dataclasses import replace
from functools import partial
from threading import Lock

from .background import Background
from .editing import Editor
from .hand import Hand
from .messages import METHOD_KEYS
from ..kinematics.modeling import extent
from ..mechanism.errors import SimulationError
from ..simulation.simulation import Simulation


class Rebuilding:
    """
    A scene that is edited, and the machines built from it.

    ``method`` returns the method of the next machine, ``adopt`` goes on with one: a hand and a
    simulation, as ``built`` returns them; ``refuse`` is called with the error when a scene went
    back that gave no machine. ``lock`` is that of the ``editor``; ``busy``: whether a machine is
    being built beside the one before.
    """

    def __init__(self, method, adopt, refuse):
        self._method, self._adopt, self._refuse = method, adopt, refuse
        self.lock, self._machines = Lock(), Background()

    def begin(self, scene):
        """Edit another scene."""
        self._machines.drop()
        self.editor = Editor(scene)

    @property
    def busy(self):
        """Return whether a machine is being built."""
        return self._machines.busy

    def tick(self):
        """Go on with a machine that has been built."""
        self._machines.tick()

    def edit(self, change, beside):
        """
        Change the scene, and go on with the machine as it is then; or change nothing.

        ``change`` does so by the editor; ``beside``: the machine before moves on until there is
        another. ValueError, SimulationError where the change is impossible, or gives no machine at
        once.
        """
        with self.lock:
            before = self.editor.state
            try:
                change()
                if not beside:
                    self.renew()
                elif not self._machines.busy:
                    self._renew_beside(before)
            except (ValueError, SimulationError):
                self.editor.withdraw(before)
                raise

    def renew(self):
        """Go on with the scene as it is edited."""
        self._machines.drop()
        self._adopt(*built(self.editor.scene, self._method()))

    def _renew_beside(self, good):
        """
        Do so once the machine is built; the one before moves on.

        ``good`` is the editor's state to go back to where there is no such machine. What is edited
        meanwhile follows next.
        """
        scene, state = self.editor.scene, self.editor.state

        def take(result):
            newest = self.editor.scene
            try:
                machine = result()
                if _alike(scene, newest):
                    self._adopt(*machine)
                if newest is not scene:
                    self._renew_beside(state)
            except (ValueError, SimulationError) as error:
                if newest is not scene:
                    self._renew_beside(good)
                    return
                with self.lock:
                    self.editor.withdraw(good)
                self._refuse(error)

        self._machines.start(partial(built, scene, self._method()), take)


def built(scene, method):
    """Return a hand in a scene, and the simulation of that by a method."""
    hand = Hand(scene, extent(scene.mechanism))
    simulation = Simulation(replace(hand.scene, method=method))
    simulation.data.prepare_exchanges()
    return hand, simulation


def carry_over(old, new, gravity, moving):
    """
    Give a simulation what pages have changed in the one before it, and, if moving, its state.

    ``gravity`` is the name of one that no scene has, so that it is not edited, or None.
    """
    if new.scene.method != old.scene.method:
        # It has been changed meanwhile.
        new.stepping.prepare_method(
            **{key: getattr(old.scene.method, key) for key in METHOD_KEYS})()
    if gravity in old.effects:
        new.set_effect(gravity, gravity in old.data.enabled_effects,
                       acceleration=old.effects[gravity].acceleration)
    if moving and old.time > 0.0 and old.coordinates.names == new.coordinates.names:
        new.set_state(old.position, old.velocity)
        new.restore(new.state, old.time)


def _alike(scene, other):
    """Return whether two scenes differ in numbers of their mechanisms alone."""
    return (scene.effects, scene.switched_off) == (other.effects, other.switched_off) and all(
        [part.name for part in getattr(scene.mechanism, parts)]
        == [part.name for part in getattr(other.mechanism, parts)]
        for parts in ('bodies', 'joints', 'cut_joints', 'points'))
