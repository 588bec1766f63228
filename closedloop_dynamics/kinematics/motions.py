# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The prescribed motions of a scene: their equations, where they start, whether they can go on."""

from dataclasses import replace

import numpy as np

from .loop_model import scaled
from ..effects.prescribed_motion import COMMANDED, PrescribedMotion
from ..engine import types as t
from ..engine.ranks import rank_of
from ..mechanism.checks import one_of
from ..mechanism.errors import AssemblyError
from ..mechanism.fields import at, FieldError

# Jumps, against the size of what jumps, or 1, that are rounding.
NO_JUMP = 1e-9
# A start that differs by more from the one of the scene is reported [rad, m].
OTHER_START = 1e-6
# Smallest singular value of the scaled Jacobian below which a limit is near: some 0.01 rad.
AT_LIMIT = 1e-2


def with_motions(scene):
    """
    Return the mechanism of a scene with the equations of the motions that it prescribes.

    Its joints that are moved take no command.
    """
    motions = tuple(filter(None, (
        record.motion(key) for key, record in scene.effects.items())))
    if not motions:
        return scene.mechanism
    moved = {motion.freedom for motion in motions}

    def unmoved(joints):
        return tuple(replace(joint, actuated=joint.actuated and joint.name not in moved)
                     for joint in joints)

    return replace(scene.mechanism, motions=motions, joints=unmoved(scene.mechanism.joints),
                   cut_joints=unmoved(scene.mechanism.cut_joints))


def moving(scene, motion):
    """
    Return a scene with further prescribed motions of joints; raise FieldError.

    By joint: an expression in the time ``t`` [rad; m], or what the scene could list.
    """
    effects = dict(scene.effects)
    for joint, law in motion.items():
        with at('motion', joint):
            if not isinstance(law, PrescribedMotion):
                law = PrescribedMotion('expression', joint=joint, expression=law)
            elif law.joint != joint:
                raise FieldError(f'a motion of {joint!r}', f'one of {law.joint or law.point!r}')
            law.fit(scene.mechanism)
        name = f'motion_{joint.replace(".", "_")}'
        while name in effects:
            name += '_'
        effects[name] = law
    return replace(scene, effects=effects)


def require_actuated(mechanism, names):
    """
    Refuse, with ValueError, torques of joints that take none.

    ``mechanism`` is as ``with_motions`` returns it; ``names`` are of the joints that torques are
    given for.
    """
    prescribed = {motion.freedom: motion.name for motion in mechanism.motions}
    for name in names:
        if name in prescribed:
            raise ValueError(f'torque: expected none of {name}, whose motion {prescribed[name]} '
                             'prescribes; a joint has a motion or a torque, not both')
        if name not in mechanism.actuated_joints:
            raise ValueError(f'torque: expected actuated joints '
                             f'({", ".join(mechanism.actuated_joints)}), got {name!r}')


class DrivingConstraints:
    """
    The prescribed motions of a scene.

    ``mechanism`` is as ``with_motions`` returns it; right-hand sides in ``cut_point`` of its model
    are written; ``place`` returns the world place of a named point, ``cut_place`` the coordinate
    of a freedom of a cut joint, at coordinates. ``records``: effects of the scene, by name; may be
    replaced by others of the same equations; ``rows``: for ``effects.effect.NameResolver``.
    """

    def __init__(self, scene, mechanism, model, place, cut_place):
        self.mechanism, self.records = mechanism, scene.effects
        self._initial, self._coordinates = scene.initial, mechanism.coordinates
        self._names = [motion.name for motion in mechanism.motions]
        self._place, self._cut_place = place, cut_place
        self.rows = {replace(motion, name=''): (self._start(motion),)
                     for motion in mechanism.motions}
        self.look_up(model)

    def look_up(self, model):
        """Find the rows in a model of other independent equations."""
        self.model, column = model, model.cut_point.shape[1] - t.MOTION_COLUMNS
        numbers = model.cut[:, t.CUT_NUMBER].tolist()
        for number, motion in enumerate(
                self.mechanism.motions, start=len(numbers) - len(self._names)):
            row, key = numbers.index(number), replace(motion, name='')
            self.rows[key] = row, int(model.cut[row, t.CUT_ROW]), column, self.rows[key][-1]

    def __bool__(self):
        return bool(self._names)

    def _start(self, motion):
        """Return where a joint or point starts in the scene [rad; m]."""
        position = np.array(self._initial.position)
        if self._in_tree(motion):
            return float(position[self._coordinate(motion)])
        if motion.freedom is not None:
            return self._cut_place(motion.freedom, position)
        return float(np.dot(motion.direction, self._place(motion.point, position)))

    def _in_tree(self, motion):
        """Return whether a joint of the tree moves."""
        return motion.freedom in self._coordinates.index

    def _coordinate(self, motion):
        return self._coordinates.place[self._coordinates.index[motion.freedom]]

    def at(self, time):
        """
        Return where the motions are, their rates and their accelerations.

        Parameters
        ----------
        time : float
            [s].

        Returns
        -------
        ndarray, shape (number of motions, 3)

        """
        return np.array([
            self.records[motion.name].at(time, self.rows[replace(motion, name='')][-1])
            for motion in self.mechanism.motions]).reshape(-1, 3)

    def set_time(self, time):
        """Set the right-hand sides to a time [s]; return them as ``at`` does."""
        values = self.at(time)
        for (row, _, column, _), each in zip(self.rows.values(), values):
            self.model.cut_point[row, column:column + 3] = each
        return values

    def begin(self, assembler, time, q, qd):
        """
        Start an assembly at the prescribed positions of a time [s].

        Right-hand sides of the assembler are set; q and qd of joints that are moved are changed in
        place.
        """
        values = self.set_time(time)
        assembler.prescribed_rates[:] = values[:, 1]
        for motion, (value, rate, _) in zip(self.mechanism.motions, values):
            if self._in_tree(motion):
                q[self._coordinate(motion)] = value
                qd[self._coordinates.index[motion.freedom]] = rate

    def require_independent(self, assembler, q):
        """Refuse, with AssemblyError, motions that the loops or other motions determine."""
        if not self:
            return
        jac = assembler.jacobian_of_largest_rank(q)
        loops = len(jac) - len(self._names)
        self._rank = rank_of(jac)
        repeated = rank_of(jac[:loops]) + len(self._names) - self._rank
        if repeated > 0:
            raise AssemblyError(
                f'{self.mechanism.name} is not free to move as prescribed by '
                f'{", ".join(self._names)}: expected motions of as many joints and points as are '
                f'independent, got {repeated} too many, or a start at a limit of the motion. '
                'Prescribe fewer motions, or start beside the limit.')

    def notes(self):
        """Return sentences on joints that start elsewhere than the scene gives."""
        found = []
        for motion, (value, _, _), (*_, start) in zip(
                self.mechanism.motions, self.at(0.0), self.rows.values()):
            if motion.freedom is not None and abs(value - start) > OTHER_START:
                found.append(f'{motion.freedom} starts at {value:.6g}, where its prescribed '
                             f'motion {motion.name} begins, not at {start:.6g} as the scene says.')
        return found

    def require_continued(self, name, record, enabled, time):
        """
        Refuse, with FieldError, a change of a motion that is invalid, or jumps.

        ``record`` is the effect as it is to become; ``enabled`` as for ``Simulation.set_effect``.
        """
        if name not in self._names:
            return
        with at('effects', name):
            if enabled is False:
                raise FieldError('a prescribed motion that stays switched on', 'false',
                                 'load a scene without it', ('enabled',))
            motion = record.motion('')
            if motion not in self.rows or self.records[name].motion('') != motion:
                raise FieldError('the joint or point that was moved when the scene was loaded',
                                 'another one', 'load a scene that moves it')
            start = self.rows[motion][-1]
            before, after = (each.at(time, start) for each in (self.records[name], record))
            for what, one, other in zip(('position', 'speed'), before, after):
                if not abs(other - one) <= NO_JUMP * max(1.0, abs(one)):
                    raise FieldError(f'a motion that goes on without a jump of its {what}',
                                     f'one from {one:.6g} to {other:.6g} at t = {time:.6g} s')

    @property
    def commanded(self):
        """
        Effects whose profile is commanded at runtime, by their names in commands.

        That is the joint that moves, or the effect's own name where a point moves.
        """
        return {motion.freedom or motion.name: motion.name for motion in self.mechanism.motions
                if self.records[motion.name].shape == COMMANDED}

    def profiles(self, commands, time):
        """
        Return the profiles of commands, keys by effect, as arguments of ``Simulation.set_effect``.

        ``commands`` are as for ``Simulation.command_motion``. FieldError.
        """
        found, known = {}, self.commanded
        for key, points in commands.items():
            one_of(tuple(known), 'one of the joints, or effects that move a point, whose profile '
                                 'is commanded')(key)
            record = self.records[known[key]]
            with at(key):
                found[known[key]] = record.commanded(
                    time, self.rows[record.motion('')][-1], *points)
        return found

    def forget_commands(self, records):
        """Return the scene's records of commanded motions."""
        return {name: records[name] for name in self.commanded.values()
                if self.records[name] != records[name]}

    def advice_on_stopping(self, assembler, q, time, step_size):
        """
        Return why a run cannot go on where a motion leads beyond a limit; '' where it does not.

        ``q`` and ``time`` [s] are those of the last good position.
        """
        try:
            for steps in (1.0, 10.0, 100.0) if self else ():
                later = time + steps * step_size
                values = self.set_time(later)
                try:
                    assembler.positions(q)
                except AssemblyError:
                    wanted = ', '.join(
                        f'{motion.freedom or motion.point} at {value:.6g}'
                        for motion, value in zip(self.mechanism.motions, values[:, 0]))
                    return (f'The prescribed motion leads beyond a limit of the mechanism: no '
                            f'position near the present one closes the loops with {wanted} (rad '
                            f'or m), as prescribed for t = {later:.9g} s. Prescribe a motion that '
                            'stays within the reach of the mechanism.')
        finally:
            if self:
                self.set_time(time)
        return self._advice_at_limit(assembler, q)

    def _advice_at_limit(self, assembler, q):
        """Return the reason why a run ends at a limit of a prescribed motion; '' otherwise."""
        if not self:
            return ''
        jac = scaled(assembler.dimensionless(q), assembler.groups)
        if np.linalg.svd(jac, compute_uv=False)[self._rank - 1] > AT_LIMIT:
            return ''
        moved = ', '.join(motion.freedom or motion.point for motion in self.mechanism.motions)
        return (f'The prescribed motion has led to a limit of the mechanism, such as a dead '
                f'centre, where {moved} can go no further: there the other joints would need '
                'rates without bound, and may go on in more than one way. Prescribe a motion that '
                'turns back before the limit, or that of a joint that passes it.')
