# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

# What __init__.py loads when it is first asked for.
from typing import Any

from .kinematics.state import State as State
from .mechanism.errors import (
    AssemblyError as AssemblyError, ClosureError as ClosureError, NumericalError as NumericalError,
    SimulationError as SimulationError, SingularityError as SingularityError)
from .mechanism.mechanism import (
    Body as Body, Coupling as Coupling, CouplingLaw as CouplingLaw, CutJoint as CutJoint,
    Joint as Joint, Mechanism as Mechanism, MechanismError as MechanismError, Point as Point)
from .mechanism.reader import read_mechanism as read_mechanism
from .scene.loading import (
    load_scene as load_scene, scene_names as scene_names, SceneError as SceneError)
from .scene.records import Initial as Initial, Method as Method, Scene as Scene
from .scene.text import write_scene as write_scene
from .simulation.evaluation import Evaluation as Evaluation
from .simulation.evaluator import Evaluator as Evaluator
from .simulation.model import Model as Model
from .simulation.model_rollout import rollout as rollout
from .simulation.reduced import feedforward as feedforward, Reduced as Reduced
from .simulation.rollout import Rollout as Rollout
from .simulation.sensitivity import Sensitivity as Sensitivity
from .simulation.simulation import Simulation as Simulation
from .simulation.stepper import Stepper as Stepper

__version__: str

c_source: Any
Differentiator: Any
fmu: Any
identify: Any
jax_dynamics: Any
Linearisation: Any
LinearModel: Any
MechanismEnv: Any
MechanismVectorEnv: Any
