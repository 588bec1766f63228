# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Drake (Tedrake et al.), beside us.

Its loops are ball constraints, which its discrete plant alone has: steps of a fixed size by the
convex solver SAP, of first order, with constraints as stiff as a step allows.
"""

import importlib.metadata

import numpy as np
from peer_cases import NotAdapted, with_balls_at_loops
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame, PrismaticJoint, RevoluteJoint, SpatialInertia, UnitInertia)
from pydrake.systems.analysis import Simulator

from closedloop_dynamics.mechanism.mechanism import (  # noqa: I100
    GROUND, PRISMATIC, REVOLUTE, SPHERICAL)

NAME = 'Drake'
# Accelerations are differences of rates over so long [s], after so many such steps: constraints
# settle within some.
SHORT, SETTLED = 1e-7, 100


class Engine:
    """
    One machine in Drake.

    Parameters
    ----------
    machine : peer_cases.Machine
        In the plane, with loops between bodies.

    Raises
    ------
    CannotExpress, NotAdapted

    """

    name, version = NAME, importlib.metadata.version('drake')
    # Its constraints give way by a fixed share, however short the step.
    agreed, limit, others = 2e-2, None, {}

    def __init__(self, machine):
        """Check the joints: plants are built for a step size."""
        machine.require_gravity_alone()
        self._gravity, self._mechanism = machine.gravity, with_balls_at_loops(
            machine.mechanism)
        for one in self._mechanism.joints:
            if one.type not in (REVOLUTE, PRISMATIC) or not machine.mechanism.planar:
                raise NotAdapted(f'{one.name}: a joint {one.type} is not built in Drake here')
        for cut in self._mechanism.cut_joints:
            # Drake 1.51.1 ends with a segmentation fault in its first step.
            if GROUND in (cut.body_a, cut.body_b) or cut.type != SPHERICAL:
                raise NotAdapted(f'{cut.name}: this loop is not built in Drake here')

    def _plant(self, step):
        """Return a plant with steps of a size [s], and its joints in our order."""
        plant = MultibodyPlant(step)
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        plant.mutable_gravity_field().set_gravity_vector(self._gravity)
        bodies, joints = {GROUND: plant.world_body()}, []
        for body in self._mechanism.bodies:
            center = np.array(body.center_of_mass)
            about = UnitInertia(*(np.array(body.inertia[:3]) / body.mass))
            bodies[body.name] = plant.AddRigidBody(body.name, SpatialInertia(
                body.mass, center, about.ShiftFromCenterOfMass(center)))
        for one in self._mechanism.joints:
            x, y, z, w = one.orientation
            frame = plant.AddFrame(FixedOffsetFrame(
                f'{one.name} base', bodies[one.parent].body_frame(), RigidTransform(
                    RotationMatrix(Quaternion(w, x, y, z)), one.position)))
            kind = RevoluteJoint if one.type == REVOLUTE else PrismaticJoint
            joints.append(plant.AddJoint(
                kind(one.name, frame, bodies[one.child].body_frame(), one.axis)))
        for cut in self._mechanism.cut_joints:
            plant.AddBallConstraint(
                bodies[cut.body_a], cut.point_a, bodies[cut.body_b], cut.point_b)
        plant.Finalize()
        self._order = [joint.position_start() for joint in joints]
        return plant

    def _simulator(self, step, q, qd, tau):
        """Return a simulator in a state under joint torques, its plant and context."""
        plant = self._plant(step)
        simulator = Simulator(plant)
        context, order = simulator.get_mutable_context(), np.argsort(self._order)
        plant.SetPositions(context, q[order])
        plant.SetVelocities(context, qd[order])
        plant.get_applied_generalized_force_input_port().FixValue(context, tau[order])
        simulator.Initialize()
        return simulator, plant, context

    def acceleration(self, q, qd, tau):
        """Return joint accelerations, shape (nv,): differences of rates over a step."""
        simulator, plant, context = self._simulator(SHORT, q, qd, tau)
        simulator.AdvanceTo((SETTLED - 0.5) * SHORT)
        before = plant.GetVelocities(context)
        simulator.AdvanceTo((SETTLED + 0.5) * SHORT)
        return (plant.GetVelocities(context) - before)[self._order] / SHORT

    def timings(self, q, qd, tau):
        """Return {what: function of a number of steps}."""
        def steps(count):
            steps.simulator.AdvanceTo(count * 1e-5)

        def prepare():
            steps.simulator, *steps.kept = self._simulator(1e-5, q, qd, tau)

        steps.prepare = prepare
        return {'discrete step (SAP)': steps}

    def lines(self, case, plan):
        """Return the ways to compute a case."""
        return [case.stepped(NAME, 'discrete (SAP)', plan.steps,
                             lambda _, step: self._motion(case, step))]

    def _motion(self, case, step):
        def execute():
            simulator, plant, context = execute.kept
            simulator.AdvanceTo(case.duration)
            return plant.GetPositions(context)[self._order]

        def prepare():
            execute.kept = self._simulator(step, case.q, case.qd, case.torques[0])

        execute.prepare = prepare
        return execute
