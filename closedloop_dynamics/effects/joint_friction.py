# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Dry friction in a joint: Coulomb and Stribeck, with exact rest.

    limit     F(v) = (F_c + mu r R) (1 + (s - 1) exp(-(v / v_s)^2)),   v = qd
    sliding   tau = -F(v) sign(v)
    at rest   tau = what keeps the joint at rest, as long as |tau| <= F(0)

Nothing is regularised: the joint does not give way, creep, or swing, and no stiffness limits the
steps. A state says which way the joint slides (1 or -1) or that it is at rest (0); it
is constant within a step and changes between steps (``engine/stick_slip.hpp``). What holds the
joints at rest is found with each evaluation (``engine/static_friction.hpp``), which costs an
evaluation more for each of them, while they rest, but for a single one
(``codegen/live_scene.py``). A joint that loops and prescribed
motions hold at rest needs no friction, and any would do: it has none.

R is the magnitude of the joint's own constraint force (in a prismatic joint: its part across
the axis), r the radius that it rubs at. It depends on the accelerations, and they on
the friction: the loop is broken by a lag, T R' = |reaction| - R, a state that is integrated
with the rest. It costs one more recursion, only where mu > 0.

When: bearings, seals and guides at low speed, whatever should stay where it stands.
"""

from dataclasses import dataclass

from .dry_friction import direction_of, friction_element
from .effect import Effect
from ..mechanism.checks import freedom, not_negative, positive
from ..mechanism.fields import FieldError


@dataclass(frozen=True)
class JointFriction(Effect):
    """
    Coulomb and Stribeck friction in a joint.

    Attributes
    ----------
    joint : str
    coulomb : float
        F_c, friction while sliding fast, zero or more [N m; N in a prismatic joint].
    static_ratio : float
        s, friction at rest over that, one or more.
    stribeck_velocity : float
        v_s, where the excess has fallen to 37 %, positive [rad/s; m/s].
    friction_coefficient : float
        mu, of the friction by the joint's constraint force, zero or more.
    radius : float
        r, arm of that friction, positive [m]; 1 in a prismatic joint.
    load_time : float
        T, positive [s].

    """

    CHECKS = {'joint': freedom, 'coulomb': not_negative, 'static_ratio': positive,
              'stribeck_velocity': positive, 'friction_coefficient': not_negative,
              'radius': positive, 'load_time': positive}
    READINGS = ('torque', 'reaction', 'limit')
    ENDS_STEPS = True

    joint: str
    coulomb: float = 0.0
    static_ratio: float = 1.0
    stribeck_velocity: float = 0.01
    friction_coefficient: float = 0.0
    radius: float = 1.0
    load_time: float = 0.002

    def __post_init__(self):
        """Refuse impossible friction parameters."""
        super().__post_init__()
        if self.static_ratio < 1.0:
            raise FieldError('a number that is one or more', f'{self.static_ratio:g}',
                             path=('static_ratio',))

    def joints(self, mechanism):
        """Return the names that ``joint`` may be: of any freedom."""
        return mechanism.coordinates.names + mechanism.cut_coordinates.names

    @property
    def friction_direction(self):
        """Return the freedom, with an arm of 1, as a tuple of one pair."""
        return ((self.joint, 1.0),)

    @property
    def depends_on_reactions(self):
        """Whether its force depends on the reaction in its joint."""
        return self.friction_coefficient * self.radius > 0.0

    def element(self, machine):
        """Return the effect as a row of the table."""
        lever = self.friction_coefficient * self.radius
        return friction_element(
            self, machine, (self.coulomb, self.static_ratio, self.stribeck_velocity, lever),
            self.load_time, joints=(machine.joint(self.joint),),
            bodies=(machine.joint_row(self.joint),), loaded=self.depends_on_reactions)

    def direction(self, rate):
        """Return the direction in which the joint slides at a rate; 0 at rest."""
        return direction_of(rate)
