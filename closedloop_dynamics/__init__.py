# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Simulate mechanisms with closed kinematic loops by subsystem-level forward dynamics.

What a user needs is loaded when it is first asked for: programs of this package install
their signal handlers before the compiler is loaded.
"""

from importlib import import_module
import os
from typing import Any, List

# The matrices here are small: more than one thread for each would only make them wait for one
# another (on a busy machine 50 times as long). Heeded where NumPy is not loaded yet; what is set
# already is left alone.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

# For type checkers __init__.pyi declares the same.
_HOMES = {
    'AssemblyError': 'mechanism.errors', 'Body': 'mechanism.mechanism',
    'ClosureError': 'mechanism.errors', 'Coupling': 'mechanism.mechanism',
    'CouplingLaw': 'mechanism.mechanism', 'CutJoint': 'mechanism.mechanism',
    'Evaluation': 'simulation.evaluation',
    'Evaluator': 'simulation.evaluator', 'feedforward': 'simulation.reduced',
    'Initial': 'scene.records', 'Joint': 'mechanism.mechanism',
    'load_scene': 'scene.loading', 'Mechanism': 'mechanism.mechanism',
    'MechanismError': 'mechanism.mechanism', 'Method': 'scene.records',
    'Model': 'simulation.model', 'NumericalError': 'mechanism.errors',
    'Point': 'mechanism.mechanism', 'read_mechanism': 'mechanism.reader',
    'Reduced': 'simulation.reduced', 'Rollout': 'simulation.rollout',
    'rollout': 'simulation.model_rollout', 'Scene': 'scene.records',
    'scene_names': 'scene.loading', 'SceneError': 'scene.loading',
    'Sensitivity': 'simulation.sensitivity', 'Simulation': 'simulation.simulation',
    'SimulationError': 'mechanism.errors', 'SingularityError': 'mechanism.errors',
    'State': 'kinematics.state', 'Stepper': 'simulation.stepper',
    'write_scene': 'scene.text'}
# Without hints of their own, and some of other packages, which may not be there.
_MORE = {
    'c_source': 'export.c_source', 'Differentiator': 'simulation.derivatives',
    'fmu': 'export.fmu', 'identify': 'studies.identification',
    'jax_dynamics': 'export.jax_dynamics', 'jax_step': 'export.jax_step',
    'Linearisation': 'simulation.linearisation',
    'LinearModel': 'simulation.linearisation', 'LinearRegulator': 'control.optimal',
    'MechanismEnv': 'export.environment',
    'MechanismVectorEnv': 'export.environment',
    'PredictiveController': 'control.optimal', 'torch_step': 'export.torch_step'}
__all__ = sorted(_HOMES)
__version__ = '1.1.0'


def __getattr__(name: str) -> Any:
    """Import a public name on first use."""
    home = _HOMES.get(name) or _MORE.get(name)
    if home is None:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(f'{__name__}.{home}'), name)


def __dir__() -> List[str]:
    return [*globals(), *__all__, *_MORE]
