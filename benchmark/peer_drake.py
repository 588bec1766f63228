# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Drake (Tedrake et al.), for the comparison in peers.py.

Its loops are ball constraints, which its discrete plant alone has: steps of a fixed size by the
convex solver SAP, of first order, with constraints as stiff as a step allows.
"""

import importlib.metadata

import numpy as np
from peer_cases import elements, gravity, point_pairs, Run
from peer_errors import NotAdapted
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame, PrismaticJoint, RevoluteJoint, SpatialInertia, UnitInertia)
from pydrake.systems.analysis import Simulator

NAME = 'Drake'
STEPS = (5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)
QUICK_STEPS = (1e-3, 5e-4)
AXES = {letter: np.eye(3)[place] for place, letter in enumerate('xyz')}
# Accelerations are differences of rates over so long [s], after so many such steps: constraints
# settle within some.
SHORT, SETTLED = 1e-7, 100


class Engine:
    """
    One scene in Drake.

    Parameters
    ----------
    scene : scene.Scene
        With gravity alone, joints of one freedom, loops between bodies. NotAdapted where it has
        others.

    """

    name, version = NAME, importlib.metadata.version('drake')
    # Its constraints give way by a fixed share: a thousandth to a hundredth of the accelerations.
    softness, others = None, {}

    def __init__(self, scene):
        """Check the joints: plants are built for a step size."""
        self._elements, self._pairs = elements(scene.mechanism), point_pairs(scene.mechanism)
        self._gravity = (*gravity(scene), 0.0)[:3]
        for one in self._elements:
            if one.type not in ('revolute', 'prismatic'):
                raise NotAdapted(f'{one.name}: a joint {one.type} is not built in Drake here')
        if any(0 in (a, b) for a, _, b, _ in self._pairs):
            # Drake 1.51.1 ends with a segmentation fault in its first step.
            raise NotAdapted('a loop that closes at the ground is not built in Drake here')

    def _plant(self, step):
        """Return a plant with steps of a size [s]."""
        plant = MultibodyPlant(step)
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        plant.mutable_gravity_field().set_gravity_vector(self._gravity)
        bodies = [plant.world_body()]
        for one in self._elements:
            center = np.array(one.center_of_mass)
            about = UnitInertia(*(np.array(one.inertia) / one.mass)).ShiftFromCenterOfMass(center)
            body = plant.AddRigidBody(one.body, SpatialInertia(one.mass, center, about))
            x, y, z, w = one.orientation
            frame = plant.AddFrame(FixedOffsetFrame(
                f'{one.name} base', bodies[one.parent].body_frame(), RigidTransform(
                    RotationMatrix(Quaternion(w, x, y, z)), one.position)))
            kind = RevoluteJoint if one.type == 'revolute' else PrismaticJoint
            plant.AddJoint(kind(one.name, frame, body.body_frame(), AXES[one.axes[0]]))
            bodies.append(body)
        for a, point_a, b, point_b in self._pairs:
            plant.AddBallConstraint(bodies[a], point_a, bodies[b], point_b)
        plant.Finalize()
        return plant

    def _simulator(self, step, q, qd, tau):
        """Return a simulator in a state under joint torques, its plant and context."""
        plant = self._plant(step)
        simulator = Simulator(plant)
        context = simulator.get_mutable_context()
        plant.SetPositions(context, q)
        plant.SetVelocities(context, qd)
        plant.get_applied_generalized_force_input_port().FixValue(context, tau)
        simulator.Initialize()
        return simulator, plant, context

    def acceleration(self, q, qd, tau):
        """Return joint accelerations, shape (nv,): differences of rates over a step."""
        simulator, plant, context = self._simulator(SHORT, q, qd, tau)
        simulator.AdvanceTo((SETTLED - 0.5) * SHORT)
        before = plant.GetVelocities(context)
        simulator.AdvanceTo((SETTLED + 0.5) * SHORT)
        return (plant.GetVelocities(context) - before) / SHORT

    def timings(self, q, qd, tau):
        """Return {what: function of a number of steps}."""
        def steps(count):
            steps.simulator.AdvanceTo(count * 1e-5)

        def prepare():
            steps.simulator, *steps.kept = self._simulator(1e-5, q, qd, tau)

        steps.prepare = prepare
        return {'discrete step (SAP)': steps}

    def runs(self, case, quick):
        """Return the runs of a case."""
        return [self._run(case, step) for step in (QUICK_STEPS if quick else STEPS)]

    def _run(self, case, step):
        kept = {}

        def prepare():
            kept['all'] = self._simulator(step, case.q, case.qd, case.tau)

        def execute():
            simulator, plant, context = kept['all']
            simulator.AdvanceTo(case.duration)
            return plant.GetPositions(context)

        return Run(NAME, 'discrete (SAP)', f'step {step:g} s', execute, prepare)
