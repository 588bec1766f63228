# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A live simulation controlled by the requests of pages."""

from dataclasses import replace
from functools import partial
import json
import math
import time
import warnings

import numpy as np

from .background import Background
from .checking import checked
from .columns import SimulationRows
from .coupler_curves import curves
from .description import CHOICES, describe, described_drive
from .driving import Driving
from .feed import Feed
from .library import Library, picture
from .messages import describe_drives, describe_effects, drive_of, FREE, METHOD_KEYS
from .own_motion import own_motion, OwnMotion
from .rebuilding import built, carry_over, Rebuilding
from .removing import removable
from .shown import Shown
from .stepping import LONGEST_WAIT, Stepper
from .watchdog import Watchdog
from ..control.errors import StartError
from ..mechanism.errors import InaccuracyWarning, SimulationError
from ..mechanism.fields import FieldError, shown
from ..recording.kinematics import assemblies, held

# Frames per second; time between two looks at what takes long [s].
RATE, POLL_PERIOD = 60.0, 0.25
# How long after a change a controller is made for the machine as it is now [s].
SETTLED = 0.3
# Rates and accelerations of a machine that stands still [rad/s, m/s; 1/s of these].
AT_REST = 1e-9


class Runner(Shown):
    """
    Runs a simulation, shows it to a feed and carries out the requests of its pages.

    ``clock`` returns seconds, steady; ``own`` returns what drives a scene from the start, given
    also what a controller is to know of it: ``own_motion.own_motion``; by default nothing;
    ``library``: machines that pages can open, and where they can save. ``described`` is by
    ``description.describe``; ``renewing``: whether a machine that was edited, or a controller for
    it, is being made while the one before moves.
    """

    def __init__(self, scene, clock=time.monotonic, own=lambda scene, model: OwnMotion(),
                 library=None):
        super().__init__()
        self._clock, self._editing = clock, False
        self._stepper = Stepper(clock, 1.0 / RATE, self._thin)
        # A machine that was edited, and a controller for it, are made while the one before moves.
        self._rebuilding = Rebuilding(
            lambda: self.simulation.scene.method, self._adopt, self._refuse)
        self._controllers = Background()
        self._failure, self._achieved, self._every = None, None, 1
        self._assemblies = None, ()
        self._library = Library() if library is None else library
        self._begin(scene, own)

    def _begin(self, scene, own):
        """Show a scene from its start; nothing changes where that fails."""
        hand, simulation = built(scene, scene.method)
        motion = own(scene, hand.scene)
        self._controllers.drop()
        self._rebuilding.begin(scene)
        self._failure, self.start_pose, self._driving = None, None, Driving(motion)
        self._own_due, self._own_waits = math.inf, False
        self._put(hand, simulation)
        for name in motion.starts:
            drive_of(self.drives, name)
        self._stepper.restart()
        self._driving.start()
        self._describe()
        self._refreshed = self._clock()
        self._send_controls()

    def _put(self, hand, simulation):
        """Go on with a simulation, with a hand in its scene."""
        self._hand, self.simulation = hand, simulation
        self._findings, self._changed = (), True
        self._driving.begin(simulation)
        self.drives = self._driving.drives
        points = len(self.editor.scene.mechanism.points)
        self.rows = SimulationRows(simulation, [hand.spring], points)
        self._begin_thinning(self.rows.columns.plots, points, hand.size)
        self._stepper.begin(simulation, self._driving, self.rows)

    def _describe(self):
        """Send the description of the machine to the pages, as it is now."""
        scene, simulation = self.editor.scene, self.simulation
        position = np.array(scene.initial.position)
        self.described = describe(
            scene.mechanism, self.rows.columns, scene.effects, mode='live',
            title=scene.name,
            drives=[described_drive(scene.mechanism, name, position,
                                    self._driving.reach(name), self._driving.modes(name))
                    for name in self.drives],
            hand=True, poses=True, gravity=self._hand.gravity, own=any(
                value is not None for _, value in self._driving.own.starts.values()),
            handles=self.editor.handles(), sliders=self.editor.sliders(),
            removable=removable(scene),
            curves=(curves(simulation.mechanism, simulation.position, scene.mechanism.points)
                    if self._editing else []), **CHOICES)
        time_and_row = simulation.time, self.rows.row()
        if self.feed is None:
            self.feed = Feed(self.described)
            self.feed.show(*time_and_row)
        else:
            self.feed.describe(self.described, *time_and_row)

    @property
    def editor(self):
        """Return the editor of the scene."""
        return self._rebuilding.editor

    @property
    def playing(self):
        """Return whether the simulation follows the clock."""
        return self._stepper.playing

    @property
    def renewing(self):
        """Return whether a machine that was edited, or a controller for it, is being made."""
        return self._rebuilding.busy or self._controllers.busy

    # The loop.

    def run(self, keep_going=lambda: True):
        """Run with a frame every sixtieth of a second, as long as ``keep_going()``."""
        due = self._clock()
        with Watchdog(LONGEST_WAIT, self.feed.is_waiting, self._report_slow) as watchdog:
            self._stepper.watchdog = watchdog
            while keep_going():
                self.tick()
                due = max(due + 1.0 / RATE, self._clock() - 1.0 / RATE)
                time.sleep(max(0.0, due - self._clock()))

    def tick(self):
        """Carry out requests, advance to the present, show the state."""
        if self._handle_requests():
            self._changed = True
        self._rebuilding.tick()
        self._controllers.tick()
        if self._clock() >= self._own_due and not self._editing:
            self._renew_controller()
        if self._stepper.wanted:
            self._guarded(self._stepper.make)
            self._changed = True
        if self._changed:
            self._show()

    def _show(self):
        now = self._clock()
        if now - self._refreshed > POLL_PERIOD or not self.playing:
            self._refreshed = now
            self._findings = self.rows.refresh().findings
            self._achieved, self._every = self._stepper.achieved(), self._stepper.every
        row = self._stepper.row()
        self._thinning.keep(self.simulation.time, self.rows.thinning_values(row))
        self.feed.show(*self._stepper.frame(row))
        self._changed = False
        self._send_controls()

    def _report_slow(self, elapsed):
        """Report to the pages how slow it is while a part of a step takes so long [s]."""
        self.feed.send_controls(achieved=self._stepper.achieved_by_part(elapsed))

    def _guarded(self, action):
        """Run an action that may fail as simulations do; pause if it does, the state kept."""
        try:
            with warnings.catch_warnings():
                # The report has it.
                warnings.simplefilter('ignore', InaccuracyWarning)
                action()
        except SimulationError as error:
            self._failure = str(error)
            self._stop()

    def _stop(self):
        self._stepper.stop()
        self._changed = True

    def _send_controls(self):
        simulation = self.simulation
        self.feed.send_controls(
            playing=self.playing, achieved=self._achieved,
            speed=self._stepper.speed, every=self._every, failure=self._failure,
            kinematic=self._kinematic, editing=self._editing,
            undoable=self.editor.undoable, findings=list(self._findings), busy=None,
            grabbed=self._grabbed, position=(
                simulation.coordinates.by_name('position', np.round(simulation.position, 6))
                if self._kinematic else None),
            motion=self._driving.motion, drives=describe_drives(self._driving.chosen),
            method={key: getattr(simulation.scene.method, key) for key in METHOD_KEYS},
            unused=list(simulation.scene.method.unused),
            effects=describe_effects(
                {name: record for name, record in simulation.effects.items()
                 if name != self._hand.spring}, simulation.data.enabled_effects.__contains__))

    # What pages ask for.

    def _do_play(self, page):
        if self._kinematic:
            self._do_kinematic(page, False)
        if self._editing:
            self._do_edit(page, False)
        if not self.playing:
            self._failure = None
            self._tell_if_at_rest()
            self._stepper.play()

    def _tell_if_at_rest(self):
        """Tell pages what would move a machine that stands in balance, without a drive."""
        simulation, names = self.simulation, list(self.drives)
        moving = (simulation.velocity, simulation.acceleration)
        if self._driving.motion == FREE and not any(np.any(np.abs(each) > AT_REST)
                                                    for each in moving):
            self.feed.log('Nothing moves this machine: it stands in balance. ' + (
                f'Give a drive a torque or a speed: {", ".join(names)}.' if names else
                'Add a drive to a joint (“edit it”, “add”), or take hold of it.'))

    def _do_pause(self, page):
        self._stop()

    def _do_step(self, page, count):
        if self._editing:
            self._do_edit(page, False)
        self._stop()
        self._failure = None
        self._stepper.ask_for(count)

    def _do_reset(self, page):
        self._stop()
        self._failure = None

        def reset():
            self.simulation.reset()
            if self.start_pose is not None:
                self.simulation.set_state(self.start_pose)
            self._driving.start()

        self._guarded(reset)
        self._stepper.restart()

    def _do_speed(self, page, factor):
        self._stepper.set_speed(factor)

    def _do_drive(self, page, joint, mode):
        self._driving.change_mode(joint, mode)

    def _do_command(self, page, joint, value):
        self._driving.command(joint, value)

    def _do_motion(self, page, which):
        self._driving.move(which)

    def _do_effect(self, page, name, enabled=None, values=None):
        if name == self._hand.spring:
            raise FieldError('an effect of the scene', shown(name), path=('name',))
        self._busily('changing the effects', lambda: self.simulation.set_effect(
            name, enabled, **(values or {})))
        controller = self._driving.own.controller
        if controller is not None:
            controller.know(name, enabled, values or {})
        with self._rebuilding.lock:
            self.editor.effect(name, name in self.simulation.data.enabled_effects,
                               self.simulation.effects[name])

    def _do_method(self, page, values):
        unknown = [key for key in values if key not in METHOD_KEYS]
        if unknown:
            raise FieldError(f'one of {", ".join(METHOD_KEYS)}', shown(unknown[0]),
                             path=('method',))

        def change():
            self.simulation.stepping.prepare_method(**values)()
            # It was the other method's.
            self._failure = None

        self._busily('preparing the method', change)

    def _busily(self, what, action):
        """Run a long action with a message to the pages; time is paused meanwhile."""
        with self._stepper.pause():
            self.feed.send_controls(busy=what)
            action()

    # The hand.

    @property
    def _posed(self):
        return self.simulation

    def _begin_grab(self, name, place):
        self.simulation.set_effect(
            self._hand.spring, True, anchor=tuple(place[:self._hand.dimensions]), point_a=name)

    def _pull(self, place):
        self.simulation.set_effect(
            self._hand.spring, anchor=tuple(place[:self._hand.dimensions]))

    def _release(self):
        if self._hand.spring in self.simulation.data.enabled_effects:
            self.simulation.set_effect(self._hand.spring, False)

    # Editing.

    def _do_edit(self, page, on):
        """Begin to edit the machine where it starts, or end it."""
        if on == self._editing:
            return
        if self._kinematic:
            self._do_kinematic(page, False)
        self._end_grab()
        self._editing, chosen = on, self._driving.chosen
        if self.start_pose is not None:
            # The columns of a simulation that starts there.
            self._rebuilding.renew()
        self._do_reset(page)
        self._driving.restore(chosen)
        self._describe()

    def _do_set(self, page, key, value):
        self._edit(lambda: self.editor.set(key, value))

    def _do_move(self, page, kind, name, at):
        self._require_editing('a pin to move')
        self._hand.require_near(at)
        self._edit(lambda: self.editor.move(kind, name, at, self.simulation.position))

    def _do_add(self, page, what, **more):
        self._require_editing('a part to add')
        self._edit(lambda: self.editor.add(what, self.simulation.position, **more))

    def _do_remove(self, page, kind, name):
        self._require_editing('a part to remove')
        also = []
        self._edit(lambda: also.extend(self.editor.remove(kind, name)))
        if also:
            self.feed.log(f'with {name} went {", ".join(also)}')

    def _do_assemble(self, page, number):
        self._require_editing('another assembly')
        scene, positions = self._assemblies
        if scene is not self.editor.scene or number >= len(positions):
            raise FieldError('one of the assemblies of the machine as it is now', shown(number),
                             path=('number',))
        self._edit(lambda: self.editor.pose(positions[number]))

    def _do_undo(self, page):
        self._edit(self.editor.undo)

    def _do_redo(self, page):
        self._edit(self.editor.redo)

    def _require_editing(self, what):
        if not self._editing:
            raise FieldError('a machine that is edited', f'{what} while it runs')

    def _edit(self, change):
        self._rebuilding.edit(change, beside=self.playing)

    def _refuse(self, error):
        self.feed.refuse(error)
        self._changed = True

    def _adopt(self, hand, new):
        """Go on with another machine, near the present state if the one before runs."""
        old, place = self.simulation, self.simulation.effects[self._hand.spring].anchor
        carry_over(old, new, None if hand.gravity in self.editor.scene.effects else hand.gravity,
                   moving=not self._editing)
        chosen = self._driving.chosen
        self._failure = self.start_pose = None
        self._put(hand, new)
        self._driving.restore(chosen)
        self._grab_again(old, place)
        same = old.coordinates.names == new.coordinates.names
        # What has other coordinates cannot wait.
        self._own_waits = same and self.playing
        self._own_due = self._clock() + SETTLED * same
        self._describe()

    def _grab_again(self, old, place):
        """Pull at what was held in the machine before; where it has gone, let go of it."""
        if self._grabbed is None:
            return
        body, number = self._grabbed
        name = old.mechanism.bodies[body].name
        bodies = [one.name for one in self.simulation.mechanism.bodies]
        try:
            if name not in bodies:
                raise FieldError('a body of the machine', shown(name))
            self._grabbed = [bodies.index(name), number]
            point = self._hand.point(*self._grabbed)
        except FieldError:
            self.holder = self._grabbed = None
            self.feed.log('What was held is no longer part of the machine.')
            return
        if not self._kinematic:
            self._begin_grab(point, place)

    def _renew_controller(self):
        """Rebuild a controller for the machine as it is now."""
        self._own_due = math.inf
        controller = self._driving.own.controller
        if controller is None:
            return
        fit = partial(controller.on, self._hand.scene)
        if self._own_waits:
            self._controllers.start(fit, self._accept_controller)
            return
        self._controllers.drop()
        self.feed.send_controls(busy='fitting the controller to the machine')
        self._accept_controller(fit)

    def _accept_controller(self, fitted):
        """Go on with the controller that a function returns, or, where it raises, without."""
        try:
            controller = fitted()
        except (StartError, SimulationError, ValueError) as error:
            self._driving.hold()
            self.feed.log('The controller does not follow this machine, whose joints are held '
                          f'instead: {error}')
            self._describe()
            return
        self._driving.follow(controller)

    # Files.

    def resource(self, path):
        """Return kind and bytes of a resource that a page requests by a path, or None."""
        if path == '/scene.yaml':
            with self._rebuilding.lock:
                return 'application/yaml; charset=utf-8', self.editor.text()[0].encode()
        if path == '/assemblies.json':
            return 'application/json', json.dumps(self._drawn_assemblies()).encode()
        return self._library.resource(path)

    def _drawn_assemblies(self):
        """Return pictures of all assemblies of the scene that is edited, or why there are none."""
        scene = self.editor.scene
        try:
            found = assemblies(scene, held(scene))
        except (ValueError, SimulationError) as error:
            return {'words': str(error), 'pictures': []}
        self._assemblies = scene, found.positions
        return {'words': f'{found}: {found.reason}', 'pictures': [
            picture(replace(scene, initial=replace(scene.initial, position=tuple(position))))
            for position in found.positions]}

    def _do_open(self, page, name, kind):
        self._open(lambda: self._library.scene(name, kind))

    def _do_load(self, page, name, text):
        self._open(lambda: self._library.read(name, text))

    def _open(self, read):
        self._stop()
        self.feed.send_controls(busy='reading the machine')
        try:
            with self._rebuilding.lock:
                self._begin(read(), own_motion)
                self._kinematic = self._editing = False
                self.holder = self._grabbed = None
        except StartError as error:
            raise FieldError('a machine that can be shown', str(error)) from None

    def _do_check(self, page, number, name, text):
        self.feed.send_controls(checked={'number': number, **checked(text, name)})

    def _do_save(self, page, name):
        with self._rebuilding.lock:
            text, kept = self.editor.text()
        path = self._library.save(name, text)
        self.feed.log(f'saved as {path}' + ('' if kept else (
            '; the words of its author could not be kept, all of it is rewritten')))

    # Kinematic mode.

    def _do_kinematic(self, page, on):
        self._stop()
        self._end_grab()
        if on:
            self._editing, self._failure = False, None
            self.simulation.set_state(self.simulation.position)
        elif self._kinematic:
            # What was posed is the start from now on.
            self.start_pose = self.simulation.position
            with self._rebuilding.lock:
                self.editor.pose(self.start_pose)
            self._do_reset(page)
        self._kinematic = on
