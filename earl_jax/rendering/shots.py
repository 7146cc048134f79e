"""What a film or a contact sheet shows of an actor's episodes."""

import math
from collections.abc import Iterable, Iterator

import numpy as np

from earl_jax.envs import State
from earl_jax.rendering.actors import Actor, episodes
from earl_jax.rendering.output import Shot
from earl_jax.rendering.scenes import Scene, view_of

DEFAULT_SECONDS = 10.0
"""Length of a film, unless the caller sets the number of steps."""
ROUNDING = 1e-6
"""Share of a control step by which the time between two frames may be shorter than 1 / fps."""
MOMENTS = 6
"""Number of moments on a sheet of one task."""
RANDOM_STEP = 40
"""The step of an episode of random actions that a sheet shows."""
PORTRAIT_SHARE = 0.75
"""Share of an episode after which a sheet of several tasks shows it."""


def frames(actor: Actor, steps: int | None, fps: float, life: bool) -> tuple[list[State], float]:
    """Return the states that a film shows, equally many steps apart, and the frames per second, at most `fps`.

    The episodes have `steps` steps in total, by default ten seconds; they form one `life`, or each starts from a reset.
    """
    seconds = view_of(actor.env).dt
    stride, left = max(1, math.ceil(1 / (fps * seconds) - ROUNDING)), steps or round(DEFAULT_SECONDS / seconds)
    states = []
    for episode in episodes(actor, life):
        length = len(episode.states.reward)
        states += [episode.at(number) for number in range(0, min(length, left + 1), stride)]
        left -= length - 1
        if left <= 0:
            break
    return states, 1 / (stride * seconds)


def moments(actor: Actor, size: tuple[int, int], camera: str | None, steps: int | None) -> Iterator[Shot]:
    """Yield six moments with their captions; `size` is height and width of an image.

    They show one episode up to its goal or `steps`; for random actions they show step 40, or `steps`, of six episodes.
    """
    upcoming = episodes(actor)
    with Scene(actor.env, size, camera) as scene:
        if actor.acting == "random":
            shown = [(next(upcoming), steps or RANDOM_STEP, f"start {number}, ") for number in range(1, MOMENTS + 1)]
        else:
            episode = next(upcoming)
            last = min(episode.last, steps or episode.last)
            shown = [(episode, round(step), "") for step in np.linspace(0, last, MOMENTS)]
        for episode, step, prefix in shown:
            step = min(step, len(episode.states.reward) - 1)
            reached = ", goal reached" * (episode.reached and step == episode.last)
            yield scene.image(episode.at(step)), f"{prefix}{step * view_of(actor.env).dt:.1f} s{reached}"


def portraits(actors: Iterable[Actor], size: tuple[int, int]) -> Iterator[Shot]:
    """Yield one moment of each of `actors`, captioned with the task's name; `size` is height and width of an image."""
    for actor in actors:
        with Scene(actor.env, size) as scene:
            episode = next(episodes(actor))
            step = RANDOM_STEP if actor.acting == "random" else round(PORTRAIT_SHARE * episode.last)
            yield scene.image(episode.at(step)), actor.env.name
