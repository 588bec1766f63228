# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Domains of their own, listeners and processes for the tests of the nodes."""

from test.ros.domains import reserve_domain
from test.ros.listener import Listener
import uuid

from programs import Programs
import pytest
import rclpy


@pytest.fixture
def domain(monkeypatch):
    """Keep one ROS domain of this host to this test, and return its number."""
    with reserve_domain() as number:
        monkeypatch.setenv('ROS_DOMAIN_ID', str(number))
        monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        yield number


@pytest.fixture
def context(domain):
    """Return an initialised context of rclpy in the domain of this test."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    yield context
    rclpy.try_shutdown(context=context)


@pytest.fixture
def make_node(context):
    """
    Return a function that creates nodes of a class.

    Its keyword arguments are parameters, so that ``make_node(SimulatorNode,
    scene='four_bar')`` needs no command line.
    """
    nodes = []

    def make(node_class, namespace=None, **parameters):
        overrides = [rclpy.Parameter(name, value=value) for name, value in parameters.items()]
        # One that refuses its parameters is destroyed, too: its name would be heard of in later
        # tests for as long as something holds the exception.
        nodes.append(node_class.__new__(node_class))
        nodes[-1].__init__(context=context, namespace=namespace, parameter_overrides=overrides)
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()


@pytest.fixture
def listener(context):
    """Return a node that collects messages and waits for them."""
    listener = Listener(f'listener_{uuid.uuid4().hex[:8]}', context)
    yield listener
    listener.destroy()


@pytest.fixture
def processes(domain, tmp_path):
    """Return a starter of the package's executables; none outlives the test."""
    processes = Programs(tmp_path, {'ROS_LOG_DIR': str(tmp_path / 'log')})
    yield processes
    processes.kill_all()
