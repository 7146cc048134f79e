"""earl_jax: autonomous (reset-free) reinforcement learning in JAX.

`make` a task, `train` a method on it over many seeds in one jitted program, look at the curves, call the policy. Names are
loaded on first use, so importing the package costs nothing and loads no simulator.
"""

import importlib
from typing import TYPE_CHECKING, Any

from earl_jax.options import forks as _forks  # noqa: F401  (it notes forks from now on)

__version__ = "0.1.0"
_NAMES = {
    "algos": "SAC TD3 Learner Method Phase list_algos list_learners make_algo method_for register_algo register_learner",
    "envs": "Env HelpBudget KinematicEnv MujocoEnv State list_envs make register_env",
    "errors": "InputError",
    "options.presets": "preset",
    "protocol": "Continuing Deployment Protocol",
    "runs.numpy_policy": "NumpyPolicy",
    "training": "Policy Problem Result evaluate lifetime list_pretrained load pretrained pretrained_info resume"
    " select_seed train",
}
_PACKAGES = ["adapters", "algos", "assets", "envs", "metrics", "protocol", "rendering", "report", "training"]
_MODULES = {name: f"{__name__}.{module}" for module, names in _NAMES.items() for name in names.split()}

if TYPE_CHECKING:
    from earl_jax.algos import (
        SAC as SAC,
        TD3 as TD3,
        Learner as Learner,
        Method as Method,
        Phase as Phase,
        list_algos as list_algos,
        list_learners as list_learners,
        make_algo as make_algo,
        method_for as method_for,
        register_algo as register_algo,
        register_learner as register_learner,
    )
    from earl_jax.envs import (
        Env as Env,
        HelpBudget as HelpBudget,
        KinematicEnv as KinematicEnv,
        MujocoEnv as MujocoEnv,
        State as State,
        list_envs as list_envs,
        make as make,
        register_env as register_env,
    )
    from earl_jax.errors import InputError as InputError
    from earl_jax.options.presets import preset as preset
    from earl_jax.protocol import Continuing as Continuing, Deployment as Deployment, Protocol as Protocol
    from earl_jax.runs.numpy_policy import NumpyPolicy as NumpyPolicy
    from earl_jax.training import (
        Policy as Policy,
        Problem as Problem,
        Result as Result,
        evaluate as evaluate,
        list_pretrained as list_pretrained,
        load as load,
        pretrained as pretrained,
        pretrained_info as pretrained_info,
        resume as resume,
        select_seed as select_seed,
        train as train,
    )
    from earl_jax.training.lifetime import lifetime as lifetime
else:
    __all__ = sorted(_MODULES)


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(importlib.import_module(_MODULES[name]), name)
    if name in _PACKAGES:
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*_MODULES, *_PACKAGES, "__version__"])
