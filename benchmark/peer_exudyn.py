# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Exudyn (Gerstmayr), for the comparison in peers.py.

Built for flexible multibody systems in redundant coordinates with implicit integration: here
bodies with three coordinates each, every joint a constraint, generalized alpha. As fast as it was
found to go: dense linear solver, modified Newton, no output.
"""

import importlib.metadata

import exudyn as exu
from exudyn import itemInterface as item
import numpy as np
from peer_cases import gravity, Referee, Run

NAME = 'Exudyn'
# Label: (spectral radius, constraints on velocity level).
METHODS = {'generalized alpha': (0.9, False), 'trapezoidal, index 2': (1.0, True)}
STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4)
QUICK_STEPS = (1e-2, 5e-3)
NEWTON_TOLERANCE = 1e-10


class Engine:
    """
    One scene in Exudyn.

    Parameters
    ----------
    scene : scene.Scene
        With gravity alone, all joints and cut joints revolute.

    """

    name, version = NAME, importlib.metadata.version('exudyn')
    softness, others = None, {}

    def __init__(self, scene):
        """Remember the mechanism: systems are built in the state they start from."""
        self._mechanism, self._gravity = scene.mechanism, gravity(scene)
        self._referee = Referee(scene)
        self._system = None

    def _build(self, q, qd, tau):
        """Return a system in a state under joint torques, and the node of each body."""
        container = exu.SystemContainer()
        system = container.AddSystem()
        objects, places = {'ground': system.AddObject(item.ObjectGround())}, {'ground': (0.0, 0.0)}
        nodes, poses = {}, self._referee.poses(q, qd)
        for body in self._mechanism.bodies:
            pose, velocity = poses[body.name]
            nodes[body.name] = system.AddNode(item.NodeRigidBody2D(
                referenceCoordinates=list(pose), initialVelocities=list(velocity)))
            objects[body.name] = system.AddObject(item.ObjectRigidBody2D(
                nodeNumber=nodes[body.name], mass=body.mass, inertia=body.inertia))
            places[body.name] = body.center_of_mass
            system.AddLoad(item.LoadMassProportional(
                markerNumber=system.AddMarker(item.MarkerBodyMass(
                    bodyNumber=objects[body.name])), loadVector=[*self._gravity, 0.0]))

        def join(body_a, point_a, body_b, point_b):
            system.AddObject(item.ObjectJointRevolute2D(markerNumbers=[
                system.AddMarker(item.MarkerBodyPosition(bodyNumber=objects[body], localPosition=[
                    point[0] - places[body][0], point[1] - places[body][1], 0.0]))
                for body, point in ((body_a, point_a), (body_b, point_b))]))

        for joint, torque in zip(self._mechanism.joints, tau):
            join(joint.parent, joint.position, joint.child, (0.0, 0.0))
            for body, sign in ((joint.child, 1.0), (joint.parent, -1.0)):
                if torque != 0.0 and body != 'ground':
                    system.AddLoad(item.LoadTorqueVector(
                        markerNumber=system.AddMarker(item.MarkerBodyRigid(
                            bodyNumber=objects[body])), loadVector=[0.0, 0.0, sign * torque]))
        for cut in self._mechanism.cut_joints:
            join(cut.body_a, cut.point_a, cut.body_b, cut.point_b)
        system.Assemble()
        return container, system, nodes

    def acceleration(self, q, qd, tau):
        """Return joint accelerations, shape (nv,): those that a run starts from."""
        container, system, _ = self._build(q, qd, tau)
        solver = exu.MainSolverImplicitSecondOrder()
        settings = _settings(1e-5, 1e-5)
        solver.InitializeSolver(system, settings)
        rates = np.array(system.systemData.GetODE2Coordinates_tt())
        solver.FinalizeSolver(system, settings)
        angular = {'ground': 0.0}
        for k, body in enumerate(self._mechanism.bodies):
            angular[body.name] = rates[3 * k + 2]
        del container
        return np.array([angular[joint.child] - angular[joint.parent]
                         for joint in self._mechanism.joints])

    def timings(self, q, qd, tau):
        """Return {what: function of a number of steps}."""
        def steps(count):
            self._system.SolveDynamic(_settings(1e-3 * count / 100.0, 1e-5))

        steps.prepare = lambda: self._keep(q, qd, tau)
        return {'implicit step': steps}

    def _keep(self, q, qd, tau):
        self._container, self._system, self._nodes = self._build(q, qd, tau)

    def runs(self, case, quick):
        """Return the runs of a case."""
        runs = []
        for label, method in METHODS.items():
            for step in QUICK_STEPS if quick else STEPS:
                settings = _settings(case.duration, step, *method)
                runs.append(Run(
                    NAME, label, f'step {step:g} s', self._motion(case, settings),
                    lambda case=case: self._keep(case.q, case.qd, case.tau)))
        return runs

    def _motion(self, case, settings):
        def execute():
            try:
                solved = self._system.SolveDynamic(settings)
            except (ValueError, RuntimeError):
                solved = False
            return self._position() if solved else np.full(len(case.q), np.nan)
        return execute

    def _position(self):
        """Return the joint coordinates."""
        angle = {'ground': 0.0}
        for body, node in self._nodes.items():
            angle[body] = float(np.ravel(self._system.GetNodeOutput(
                node, exu.OutputVariableType.Rotation))[-1])
        return np.array([angle[joint.child] - angle[joint.parent] - joint.angle
                         for joint in self._mechanism.joints])


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
