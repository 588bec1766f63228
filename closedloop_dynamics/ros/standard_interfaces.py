# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The services and the action of ``simulation_interfaces``, as other simulators have them.

Each body of the mechanism is an entity. The package of these messages is optional; this module is
imported where it is installed.
"""

import math
import re
import time
from typing import Callable, NamedTuple

from closedloop_dynamics.mechanism.errors import SimulationError
from closedloop_dynamics.mechanism.kinematics import poses_in_space
from closedloop_dynamics.ros.commands import SERVICE_QOS
from closedloop_dynamics.ros.frames import WORLD
from closedloop_dynamics.ros.messages import fill
from closedloop_dynamics.ros.pacing import SLICE
from closedloop_dynamics.visual.placement import Placement, PlacementError
import numpy as np
from rclpy.action import ActionServer, CancelResponse
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import (
    Bounds, EntityCategory, EntityInfo, EntityState, Result, SimulationState, SimulatorFeatures,
    TagsFilter)
from simulation_interfaces.srv import (
    GetEntities, GetEntitiesStates, GetEntityInfo, GetEntityState, GetSimulationState,
    GetSimulatorFeatures, ResetSimulation, SetEntityState, SetSimulationState, StepSimulation)

# Steps that the service makes in one call; the action makes any number.
MOST_STEPS = 100_000
# How far the length of a quaternion may be from 1.
UNIT = 1e-3
_FEATURES = (
    'ENTITY_TAGS', 'ENTITY_CATEGORIES', 'ENTITY_STATE_GETTING', 'ENTITY_STATE_SETTING',
    'ENTITY_INFO_GETTING', 'SIMULATION_RESET', 'SIMULATION_RESET_TIME', 'SIMULATION_RESET_STATE',
    'SIMULATION_STATE_GETTING', 'SIMULATION_STATE_SETTING', 'SIMULATION_STATE_PAUSE',
    'STEP_SIMULATION_SINGLE', 'STEP_SIMULATION_MULTIPLE', 'STEP_SIMULATION_ACTION')


class Refusal(Exception):
    """A refused request, with the code for its result; the message gives the reason."""

    def __init__(self, code, message):
        super().__init__(message)
        self.code = code


class RunControl(NamedTuple):
    """Actions of requests on a run: methods of the simulator node."""

    # Whether time is paused; another reason why it does not run, or ''; why nothing can be
    # answered now, or ''.
    paused: Callable
    standing: Callable
    problem: Callable
    # Takes whether to pause.
    pause: Callable
    # Back to the start; time alone.
    restart: Callable
    restart_time: Callable
    # Takes the number of steps.
    make_steps: Callable
    # Takes position and rates, shapes (nq,), (nv,).
    move_to: Callable
    # End the node.
    end: Callable
    # Return a task of the executor, to be waited for.
    let_others_run: Callable


class StandardInterfaces:
    """
    Answers the requests of ``simulation_interfaces`` for a simulator node.

    ``node`` creates the services, ``control``, a RunControl, does what is asked of ``live``.
    """

    def __init__(self, node, live, control):
        self._control, self._simulation, self._stamps = control, live.simulation, live.stamps
        mechanism = self._simulation.mechanism
        self._bodies = {body.name: body for body in mechanism.bodies}
        self._tags = {name: [tag for tag, holds in (
            ('body', True), (mechanism.name, True), ('massless', body.massless)) if holds]
            for name, body in self._bodies.items()}
        self._rows = {name: row for row, name in enumerate(self._bodies)}
        self._placement = Placement(mechanism)
        self._start = self._simulation.position.copy(), self._simulation.velocity.copy()
        # Paused, and nothing has happened since the start.
        self._stopped, self._stepping = False, False
        self._interrupted = False
        live.on_advance.append(self._begin)
        live.on_jump.append(self._jumped)
        for kind, name, answer in (
                (GetSimulatorFeatures, 'get_simulator_features', self.on_features),
                (GetSimulationState, 'get_simulation_state', self.on_get_state),
                (SetSimulationState, 'set_simulation_state', self.on_set_state),
                (ResetSimulation, 'reset_simulation', self.on_reset),
                (StepSimulation, 'step_simulation', self.on_step),
                (GetEntities, 'get_entities', self.on_entities),
                (GetEntitiesStates, 'get_entities_states', self.on_entities_states),
                (GetEntityInfo, 'get_entity_info', self.on_entity_info),
                (GetEntityState, 'get_entity_state', self.on_entity_state),
                (SetEntityState, 'set_entity_state', self.on_set_entity_state)):
            node.create_service(kind, f'~/{name}', answer, qos_profile=SERVICE_QOS)
        self._action = ActionServer(
            node, SimulateSteps, '~/simulate_steps', self.on_simulate_steps,
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
            goal_service_qos_profile=SERVICE_QOS, result_service_qos_profile=SERVICE_QOS,
            cancel_service_qos_profile=SERVICE_QOS, feedback_pub_qos_profile=SERVICE_QOS)

    def _begin(self, torque):
        self._stopped = False

    def _jumped(self):
        self._stopped, self._interrupted = False, True

    def _answer(self, response, action):
        """Fill a response by an action, with the outcome in its result."""
        response.result.result = Result.RESULT_OK
        try:
            self._require_idle()
            action()
        except Refusal as refusal:
            response.result.result = refusal.code
            response.result.error_message = str(refusal)
        return response

    def _require_idle(self):
        if problem := self._control.problem():
            raise Refusal(Result.RESULT_OPERATION_FAILED, problem)

    # The simulation.

    def on_features(self, request, response):
        """Return the supported features of the standard."""
        response.features.features = [getattr(SimulatorFeatures, name) for name in _FEATURES]
        response.features.custom_info = (
            f"closedloop_dynamics, scene '{self._simulation.scene.name}'; each body of the "
            'mechanism is an entity')
        return response

    @property
    def _state(self):
        if not self._control.paused():
            return SimulationState.STATE_PLAYING
        return SimulationState.STATE_STOPPED if self._stopped else SimulationState.STATE_PAUSED

    def on_get_state(self, request, response):
        """Return whether time runs, is paused, or is stopped at the start."""
        def action():
            response.state.state = self._state
            response.result.error_message = self._standing()
        return self._answer(response, action)

    def _standing(self):
        """Return the reason why time does not run although it is not paused, or ''."""
        return '' if self._control.paused() else self._control.standing()

    def on_set_state(self, request, response):
        """Run, pause, reset, or end the node."""
        def action():
            self._go_to(request.state.state)
            response.result.error_message = self._standing()
        return self._answer(response, action)

    def _go_to(self, state):
        if state not in (SimulationState.STATE_PLAYING, SimulationState.STATE_PAUSED,
                         SimulationState.STATE_STOPPED, SimulationState.STATE_QUITTING):
            raise Refusal(Result.RESULT_FEATURE_UNSUPPORTED,
                          f'expected a state playing, paused, stopped or quitting, got {state}')
        if state == self._state:
            raise Refusal(SetSimulationState.Response.ALREADY_IN_TARGET_STATE,
                          'already in this state')
        if state == SimulationState.STATE_QUITTING:
            self._control.end()
            return
        self._control.pause(state != SimulationState.STATE_PLAYING)
        if state == SimulationState.STATE_STOPPED:
            self._control.restart()
        self._stopped = state == SimulationState.STATE_STOPPED
        self._require_idle()

    def on_reset(self, request, response):
        """Go back to the start: time, state, or both."""
        return self._answer(response, lambda: self._reset(request.scope))

    def _reset(self, scope):
        whole = ResetSimulation.Request.SCOPE_TIME | ResetSimulation.Request.SCOPE_STATE
        # Nothing can be spawned: nothing of it is left.
        parts = whole & (scope or ResetSimulation.Request.SCOPE_ALL)
        if not parts:
            raise Refusal(Result.RESULT_FEATURE_UNSUPPORTED,
                          'nothing can be spawned here; reset time or state')
        try:
            if parts == whole:
                self._control.restart()
            elif parts == ResetSimulation.Request.SCOPE_STATE:
                self._control.move_to(*self._start)
            else:
                self._control.restart_time()
        except (SimulationError, ValueError) as error:
            raise Refusal(Result.RESULT_OPERATION_FAILED, str(error)) from None
        self._require_idle()

    # Steps.

    def _require_steps_possible(self, count):
        if not self._control.paused():
            raise Refusal(Result.RESULT_OPERATION_FAILED,
                          'expected a simulation that is paused, got one that is not')
        if self._stepping:
            raise Refusal(Result.RESULT_OPERATION_FAILED, 'simulate_steps is making steps')
        if count == 0:
            raise Refusal(Result.RESULT_OPERATION_FAILED, 'expected 1 or more steps, got 0')

    def on_step(self, request, response):
        """Make steps of the time integration while paused."""
        def action():
            self._require_steps_possible(request.steps)
            if request.steps > MOST_STEPS:
                raise Refusal(Result.RESULT_OPERATION_FAILED, (
                    f'expected {MOST_STEPS} steps at most, got {request.steps}; the action '
                    'simulate_steps makes any number, and can be cancelled'))
            self._control.make_steps(request.steps)
            self._require_idle()
        return self._answer(response, action)

    async def on_simulate_steps(self, goal):
        """Make steps while paused; each is published. Other callbacks run in between."""
        found = SimulateSteps.Result()
        self._answer(found, lambda: self._require_steps_possible(goal.request.steps))
        if found.result.result != Result.RESULT_OK:
            goal.abort()
            return found
        self._stepping, self._interrupted = True, False
        try:
            await self._make_steps(goal)
            self._answer(found, lambda: None)
        except Refusal as refusal:
            found.result.result, found.result.error_message = refusal.code, str(refusal)
        finally:
            self._stepping = False
        if goal.is_cancel_requested:
            goal.canceled()
        elif found.result.result == Result.RESULT_OK:
            goal.succeed()
        else:
            goal.abort()
        return found

    async def _make_steps(self, goal):
        wanted = goal.request.steps
        progress = SimulateSteps.Feedback()
        while progress.completed_steps < wanted:
            end = time.monotonic() + SLICE
            while progress.completed_steps < wanted and time.monotonic() < end:
                self._control.make_steps(1)
                self._require_idle()
                progress.completed_steps += 1
                progress.remaining_steps = wanted - progress.completed_steps
                goal.publish_feedback(progress)
            # Other callbacks are run.
            await self._control.let_others_run()
            made = f'after {progress.completed_steps} of {wanted} steps'
            if goal.is_cancel_requested:
                raise Refusal(Result.RESULT_OPERATION_FAILED, f'cancelled {made}')
            if self._interrupted or not self._control.paused():
                raise Refusal(Result.RESULT_OPERATION_FAILED,
                              f'interrupted {made}: the simulation was reset, moved or let run')

    # Entities.

    def on_entities(self, request, response):
        """Return the names of bodies."""
        def action():
            response.entities = self._filtered(request.filters)
        return self._answer(response, action)

    def on_entities_states(self, request, response):
        """Return the names and states of bodies."""
        def action():
            response.entities = self._filtered(request.filters)
            response.states = list(map(self._state_of, response.entities))
        return self._answer(response, action)

    def on_entity_info(self, request, response):
        """Return the description of a body."""
        def action():
            name = self._known(request.entity)
            response.info = EntityInfo(
                category=EntityCategory(category=EntityCategory.CATEGORY_ROBOT),
                description=f'body of {self._simulation.mechanism.name}, '
                            f'{self._bodies[name].mass:g} kg', tags=self._tags[name])
        return self._answer(response, action)

    def on_entity_state(self, request, response):
        """Return where a body is and how it moves."""
        def action():
            response.state = self._state_of(self._known(request.entity))
        return self._answer(response, action)

    def _known(self, name):
        if name not in self._bodies:
            raise Refusal(Result.RESULT_NOT_FOUND,
                          f"expected one of {', '.join(self._bodies)}, got '{name}'")
        return name

    def _filtered(self, filters):
        """Return the names of bodies that pass all filters."""
        if filters.bounds.type != Bounds.TYPE_EMPTY:
            raise Refusal(Result.RESULT_FEATURE_UNSUPPORTED, 'bodies have no bounds here')
        try:
            pattern = re.compile(filters.filter)
        except re.error as error:
            raise Refusal(Result.RESULT_OPERATION_FAILED, (
                f"filter: expected a regular expression, got '{filters.filter}': {error}")
                ) from None
        categories = {one.category for one in filters.categories}
        tags = set(filters.tags.tags)
        if filters.tags.filter_mode not in (TagsFilter.FILTER_MODE_ANY,
                                            TagsFilter.FILTER_MODE_ALL):
            raise Refusal(Result.RESULT_OPERATION_FAILED, (
                f'filter_mode: expected any or all, got {filters.tags.filter_mode}'))
        matches = tags.issubset if (
            filters.tags.filter_mode == TagsFilter.FILTER_MODE_ALL) else (
                lambda own: not tags.isdisjoint(own))
        return [name for name in self._bodies
                if pattern.search(name)
                and (not categories or EntityCategory.CATEGORY_ROBOT in categories)
                and (not tags or matches(self._tags[name]))]

    def _state_of(self, name):
        """Return an EntityState: of the origin of a body's frame, in the world."""
        simulation, state = self._simulation, EntityState()
        state.header.frame_id, state.header.stamp = WORLD, self._stamps.message()
        place, turn = state.pose.position, state.pose.orientation
        pose = poses_in_space(simulation.body_poses[self._rows[name]])
        place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = pose.tolist()
        q, qd = simulation.position, simulation.velocity
        for message, numbers in (
                (state.twist, self._placement.velocity(q, qd, name)),
                (state.acceleration, self._placement.acceleration(
                    q, qd, simulation.acceleration, name))):
            fill(message.linear, message.angular, numbers.tolist())
        return state

    def on_set_entity_state(self, request, response):
        """Set the pose or velocity of a body, as far as the loops allow."""
        return self._answer(response, lambda: self._move(request))

    def _move(self, request):
        name, state = self._known(request.entity), request.state
        if request.set_acceleration:
            raise Refusal(Result.RESULT_FEATURE_UNSUPPORTED,
                          'accelerations follow from forces; set_acceleration must be false')
        if state.header.frame_id not in ('', WORLD):
            raise Refusal(Result.RESULT_FEATURE_UNSUPPORTED, (
                f"frame_id: expected '{WORLD}' or none, got '{state.header.frame_id}'"))
        simulation = self._simulation
        position, rates = simulation.position.copy(), simulation.velocity.copy()
        code = SetEntityState.Response.INVALID_POSE
        try:
            if request.set_pose:
                position = self._placement.position(position, name, _pose(state.pose))
            code = Result.RESULT_OPERATION_FAILED
            if request.set_twist:
                twist = state.twist
                rates = self._placement.rates(position, rates, name, _finite(
                    [getattr(part, axis) for part in (twist.linear, twist.angular)
                     for axis in 'xyz'], code))
            if request.set_pose or request.set_twist:
                self._control.move_to(position, rates)
        except (PlacementError, SimulationError, ValueError) as error:
            raise Refusal(code, str(error)) from None
        self._require_idle()


def _pose(pose):
    """Return place and unit quaternion of a message, shape (7,)."""
    place, turn = pose.position, pose.orientation
    numbers = _finite([place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w],
                      SetEntityState.Response.INVALID_POSE)
    length = np.linalg.norm(numbers[3:])
    if abs(length - 1.0) > UNIT:
        raise Refusal(SetEntityState.Response.INVALID_POSE,
                      f'expected a unit quaternion, got one of length {length:g}')
    numbers[3:] /= length
    return numbers


def _finite(numbers, code):
    if not all(map(math.isfinite, numbers)):
        raise Refusal(code, f'expected finite numbers, got {numbers}')
    return np.array(numbers)
