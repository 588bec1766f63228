# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Exudyn (Gerstmayr), beside us.

Built for flexible multibody systems in redundant coordinates with implicit integration: here
bodies with three coordinates each, every joint a constraint, generalized alpha. As fast as it was
found to go: dense linear solver, modified Newton, no output.
"""

import importlib.metadata

import exudyn as exu
from exudyn import itemInterface as item
import numpy as np
from peer_cases import NotAdapted

from closedloop_dynamics.mechanism.mechanism import GROUND, REVOLUTE  # noqa: I100

NAME = 'Exudyn'
# Label: (spectral radius, constraints on velocity level).
METHODS = {'generalized alpha': (0.9, False), 'trapezoidal, index 2': (1.0, True)}
NEWTON_TOLERANCE = 1e-10


class Engine:
    """
    One machine in Exudyn.

    Parameters
    ----------
    machine : peer_cases.Machine
        In the plane, all joints and cut joints revolute.

    Raises
    ------
    CannotExpress, NotAdapted

    """

    name, version = NAME, importlib.metadata.version('exudyn')
    agreed, limit, others = 1e-5, None, {}

    def __init__(self, machine):
        """Remember the mechanism: systems are built in the state they start from."""
        self._mechanism, self._gravity = machine.mechanism, machine.gravity
        machine.require_gravity_alone()
        if not self._mechanism.planar or self._mechanism.couplings:
            raise NotAdapted('only planar mechanisms without couplings are built in Exudyn here')
        for one in (*self._mechanism.joints, *self._mechanism.cut_joints):
            if one.type != REVOLUTE:
                raise NotAdapted(f'{one.name}: a joint {one.type} is not built in Exudyn here')

    def _poses(self, q, qd):
        """Return {body: (x, y, angle), and their rates} of the centres of mass."""
        centers = {body.name: complex(*body.center_of_mass) for body in self._mechanism.bodies}
        # Of the bodies' origins: place, angle, velocity and angular velocity; x + i y.
        origins, found = {GROUND: (0.0, 0.0, 0.0, 0.0)}, {}
        for joint, turned, rate in zip(self._mechanism.joints, q, qd):
            place, angle, velocity, spin = origins[joint.parent]
            arm = np.exp(1j * angle) * complex(*joint.position)
            place, velocity = place + arm, velocity + 1j * spin * arm
            angle, spin = angle + joint.angle + turned, spin + rate
            origins[joint.child] = place, angle, velocity, spin
            arm = np.exp(1j * angle) * centers[joint.child]
            place, velocity = place + arm, velocity + 1j * spin * arm
            found[joint.child] = ((place.real, place.imag, angle),
                                  (velocity.real, velocity.imag, spin))
        return found

    def _build(self, q, qd, tau):
        """Build a system in a state under joint torques, with the node of each body."""
        self._container = exu.SystemContainer()
        self._system = system = self._container.AddSystem()
        objects, centers = {GROUND: system.AddObject(item.ObjectGround())}, {GROUND: (0.0, 0.0)}
        self._nodes, poses = {}, self._poses(q, qd)
        for body in self._mechanism.bodies:
            pose, velocity = poses[body.name]
            self._nodes[body.name] = system.AddNode(item.NodeRigidBody2D(
                referenceCoordinates=list(pose), initialVelocities=list(velocity)))
            objects[body.name] = system.AddObject(item.ObjectRigidBody2D(
                nodeNumber=self._nodes[body.name], mass=body.mass, inertia=body.inertia))
            centers[body.name] = body.center_of_mass
            system.AddLoad(item.LoadMassProportional(
                markerNumber=system.AddMarker(item.MarkerBodyMass(
                    bodyNumber=objects[body.name])), loadVector=list(self._gravity)))

        def join(*ends):
            system.AddObject(item.ObjectJointRevolute2D(markerNumbers=[
                system.AddMarker(item.MarkerBodyPosition(bodyNumber=objects[body], localPosition=[
                    *np.subtract(point, centers[body]), 0.0])) for body, point in ends]))

        for joint, torque in zip(self._mechanism.joints, tau):
            join((joint.parent, joint.position), (joint.child, (0.0, 0.0)))
            for body, sign in ((joint.child, 1.0), (joint.parent, -1.0)):
                if torque != 0.0 and body != GROUND:
                    system.AddLoad(item.LoadTorqueVector(
                        markerNumber=system.AddMarker(item.MarkerBodyRigid(
                            bodyNumber=objects[body])), loadVector=[0.0, 0.0, sign * torque]))
        for cut in self._mechanism.cut_joints:
            join((cut.body_a, cut.point_a), (cut.body_b, cut.point_b))
        system.Assemble()

    def _relative(self, angles):
        """Return the differences of bodies' angles, or of derivatives, in joints."""
        angles = {GROUND: 0.0, **angles}
        return np.array([angles[joint.child] - angles[joint.parent]
                         for joint in self._mechanism.joints])

    def acceleration(self, q, qd, tau):
        """Return joint accelerations, shape (nv,): those that a run starts from."""
        self._build(q, qd, tau)
        solver, settings = exu.MainSolverImplicitSecondOrder(), _settings(1e-5, 1e-5)
        solver.InitializeSolver(self._system, settings)
        rates = np.array(self._system.systemData.GetODE2Coordinates_tt())
        solver.FinalizeSolver(self._system, settings)
        return self._relative(dict(zip(self._nodes, rates[2::3])))

    def timings(self, q, qd, tau):
        """Return {what: function of a number of steps}."""
        def steps(count):
            self._system.SolveDynamic(_settings(1e-3 * count / 100.0, 1e-5))

        steps.prepare = lambda: self._build(q, qd, tau)
        return {'implicit step': steps}

    def lines(self, case, plan):
        """Return the ways to compute a case."""
        return [case.stepped(NAME, label, plan.steps, lambda _, step, method=method: self._motion(
            case, _settings(case.duration, step, *method))) for label, method in METHODS.items()]

    def _motion(self, case, settings):
        def execute():
            try:
                solved = self._system.SolveDynamic(settings)
            except (ValueError, RuntimeError):
                solved = False
            return self._position() if solved else np.full(len(case.q), np.nan)

        execute.prepare = lambda: self._build(case.q, case.qd, case.torques[0])
        return execute

    def _position(self):
        """Return the joint coordinates."""
        return self._relative({body: float(np.ravel(self._system.GetNodeOutput(
            node, exu.OutputVariableType.Rotation))[-1]) for body, node in self._nodes.items()}
        ) - [joint.angle for joint in self._mechanism.joints]


def _settings(duration, step, radius=0.9, index_2=False):
    """Return the settings of a run without any output."""
    settings = exu.SimulationSettings()
    integration = settings.timeIntegration
    integration.numberOfSteps, integration.endTime = round(duration / step), duration
    integration.verboseMode = 0
    integration.newton.useModifiedNewton = True
    integration.newton.relativeTolerance = NEWTON_TOLERANCE
    integration.newton.absoluteTolerance = NEWTON_TOLERANCE
    integration.generalizedAlpha.spectralRadius = radius
    integration.generalizedAlpha.useIndex2Constraints = index_2
    integration.generalizedAlpha.useNewmark = index_2
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = 1e9
    settings.linearSolver.solverType = exu.LinearSolverType.EXUdense
    settings.parallel.numberOfThreads = 1
    settings.show.statistics = settings.show.computationTime = False
    return settings
