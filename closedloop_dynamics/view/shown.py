# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Requests of pages to a machine, simulated here or by a node elsewhere."""

from .messages import drive_of, require_kinematic
from .posing import joint_to, point_to
from .thinning import Thinning
from ..mechanism.errors import SimulationError
from ..mechanism.fields import FieldError, shown

# Messages of which the newest counts where they come faster than frames.
NEWEST = 'pull', 'pose', 'command', 'move', 'set'


class Shown:
    """
    A machine that pages show, drive, take hold of and pose by hand.

    What a page asks for under a name is done by ``_do_NAME(page, ...)``. ``drives`` are by joint;
    ``holder``: the page that has taken hold of something, or None.
    """

    def __init__(self):
        self.feed, self.holder, self.drives = None, None, {}
        # What is held: numbers of a body and of a place of it.
        self._grabbed, self._kinematic, self._hand = None, False, None
        # States between frames: selection of those sent, and the newest.
        self._thinning, self._newest = None, None

    # For each of both.

    @property
    def _posed(self):
        """Return the simulation that is posed by hand."""
        raise NotImplementedError

    def _on_posed(self):
        """Report the pose to subclasses."""

    def _begin_grab(self, name, place):
        """Begin to pull a named point to a place."""
        raise NotImplementedError

    def _pull(self, place):
        """Pull the held point to another place."""
        raise NotImplementedError

    def _release(self):
        """Pull no more."""
        raise NotImplementedError

    # What pages see.

    def _begin_thinning(self, plots, points, size):
        """Start to select states between frames; see ``thinning.Thinning``."""
        self._thinning, self._newest = Thinning(plots, points, size), None

    def _thin(self, time, row, values):
        """Check a state; send the one before where a line to this would miss it."""
        if self._thinning.misses(time, values):
            self.feed.sample(*self._newest)
        self._newest = time, row

    # What pages ask for.

    def _handle_requests(self):
        """Carry out the requests since the last time; return whether there were any."""
        asked = list(self.feed.messages())
        latest = {}
        for number, (page, message) in enumerate(asked):
            if message['do'] in NEWEST:
                latest[_key(page, message)] = number
        for number, (page, message) in enumerate(asked):
            if latest.get(_key(page, message), number) != number:
                continue
            try:
                what = message.pop('do')
                action = getattr(self, f'_do_{what}', None)
                if action is None:
                    raise FieldError('an action that this machine has', shown(what),
                                     path=('do',))
                action(page, **message)
            except (ValueError, SimulationError) as error:
                self.feed.refuse(error)
        return bool(asked)

    # What is taken hold of: posed, or pulled.

    def _do_grab(self, page, body, place, at):
        self._hand_is_there()
        self._hand.require_near(at)
        name = self._hand.point(body, place)
        self._end_grab()
        self.holder, self._grabbed = page, [body, place]
        if self._kinematic:
            self._pose_to(at)
        else:
            self._begin_grab(name, at)

    def _hand_is_there(self):
        """Raise FieldError where nothing can be taken hold of."""

    def _do_pull(self, page, at):
        if page is not self.holder:
            return
        self._hand.require_near(at)
        if self._kinematic:
            self._pose_to(at)
        else:
            self._pull(at)

    def _do_release(self, page):
        if page is self.holder:
            self._end_grab()

    def _end_grab(self):
        if self._grabbed is not None and not self._kinematic:
            self._release()
        self.holder = self._grabbed = None

    def _pose_to(self, at):
        point_to(self._posed, self._hand.point(*self._grabbed), at)
        self._on_posed()

    def _do_pose(self, page, joint, value):
        require_kinematic(self._kinematic)
        drive_of(self.drives, joint)
        joint_to(self._posed, joint, value)
        self._on_posed()


def _key(page, message):
    return message['do'], message.get('joint') or message.get('key'), id(page)
