"""earl_jax: autonomous (reset-free) reinforcement learning in JAX.

`make` a task, `train` a method on it over many seeds in one jitted program, look at the curves, call the policy. Names are
loaded on first use, so importing the package costs nothing and loads no simulator.
"""

from typing import TYPE_CHECKING

from earl_jax.options import lazy

if TYPE_CHECKING:
    from earl_jax.algos import (
        SAC,
        TD3,
        Learner,
        Method,
        Phase,
        list_algos,
        list_learners,
        make_algo,
        method_for,
        register_algo,
        register_learner,
    )
    from earl_jax.envs import Env, HelpBudget, KinematicEnv, MujocoEnv, State, list_envs, make, register_env
    from earl_jax.errors import InputError
    from earl_jax.options.presets import preset
    from earl_jax.protocol import Continuing, Deployment, Protocol
    from earl_jax.runs.numpy_policy import NumpyPolicy
    from earl_jax.training import (
        Policy,
        Problem,
        Result,
        evaluate,
        lifetime,
        list_pretrained,
        load,
        pretrained,
        pretrained_info,
        resume,
        select_seed,
        train,
    )

__all__ = [
    "SAC",
    "TD3",
    "Continuing",
    "Deployment",
    "Env",
    "HelpBudget",
    "InputError",
    "KinematicEnv",
    "Learner",
    "Method",
    "MujocoEnv",
    "NumpyPolicy",
    "Phase",
    "Policy",
    "Problem",
    "Protocol",
    "Result",
    "State",
    "evaluate",
    "lifetime",
    "list_algos",
    "list_envs",
    "list_learners",
    "list_pretrained",
    "load",
    "make",
    "make_algo",
    "method_for",
    "preset",
    "pretrained",
    "pretrained_info",
    "register_algo",
    "register_env",
    "register_learner",
    "resume",
    "select_seed",
    "train",
]
__version__ = "0.1.0"
__getattr__ = lazy.attributes(
    __name__,
    {
        "algos": "SAC TD3 Learner Method Phase list_algos list_learners make_algo method_for register_algo register_learner",
        "envs": "Env HelpBudget KinematicEnv MujocoEnv State list_envs make register_env",
        "errors": "InputError",
        "options.presets": "preset",
        "protocol": "Continuing Deployment Protocol",
        "runs.numpy_policy": "NumpyPolicy",
        "training": "Policy Problem Result evaluate lifetime list_pretrained load pretrained pretrained_info resume"
        " select_seed train",
    },
)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
