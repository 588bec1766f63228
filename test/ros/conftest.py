# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Domains of their own, listeners, nodes and processes for the tests of the nodes.

Nodes run in the process of the tests wherever that shows the same. One test for each starts it as
a process, and so do those of signals, of being killed, and of what a process has to itself.
"""

from test.ros.domains import reserve_domain
from test.ros.listener import Listener
import uuid

from closedloop_dynamics.ros.recorder_node import RecorderNode
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
    scene='four_bar')`` needs no command line; ``arguments`` are others of ROS.
    """
    nodes = []

    def make(node_class, namespace=None, arguments=(), **parameters):
        overrides = [rclpy.Parameter(name, value=value) for name, value in parameters.items()]
        # One that refuses its parameters is destroyed, too: its name would be heard of in later
        # tests for as long as something holds the exception.
        nodes.append(node_class.__new__(node_class))
        nodes[-1].__init__(context=context, namespace=namespace, parameter_overrides=overrides,
                           cli_args=['--ros-args', *arguments])
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
def run(make_node, listener):
    """Return a function as ``make_node``, whose nodes run while the listener waits."""
    def started(*options, **parameters):
        node = make_node(*options, **parameters)
        listener.add(node)
        return node

    return started


@pytest.fixture
def record(run, listener, tmp_path):
    """
    Return a function that creates a recorder, which writes into ``tmp_path / 'bag'``.

    Its ``wait_for(*topics)`` waits until it has received a message of each; ``end()`` stops all
    others first, then closes the bag.
    """
    def started(namespace=None, **parameters):
        recorder = run(RecorderNode, namespace, output=str(tmp_path / 'bag'), **parameters)
        recorder.end = lambda: (listener.leave_alone(recorder), recorder.close())
        recorder.wait_for = lambda *topics: listener.wait(lambda: all(
            recorder.received[f'/{topic}'] for topic in topics), f'messages of {topics}')
        return recorder

    return started


@pytest.fixture
def processes(domain, tmp_path):
    """Return a starter of the package's executables; none outlives the test."""
    processes = Programs(tmp_path, {'ROS_LOG_DIR': str(tmp_path / 'log')})
    yield processes
    processes.kill_all()
