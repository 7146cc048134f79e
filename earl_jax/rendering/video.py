"""From a run folder or the name of a task to a video, a moving picture or a sheet of moments."""

import contextlib
import importlib
import operator
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import track

from earl_jax.envs import Env, HelpBudget, State, list_envs, make, with_physics
from earl_jax.rendering.scenes import Scene
from earl_jax.runs.folder import RunFolder
from earl_jax.training import Policy, load_lanes, select_seed

ACTINGS = ("policy", "expert", "demos", "random")
"""Who acts: the newest policy of a run, a scripted expert, the shipped demonstrations once more, or chance."""
ALL = "all"
SIX = ("tabletop_organization", "sawyer_door", "sawyer_peg", "franka_kitchen", "dhand_lightbulb", "minitaur_pen")
"""The paper's tasks, which the source `all` stands for."""
SIZES = {".mp4": (480, 640), ".gif": (240, 320), ".png": (240, 320)}
"""Height and width of a frame, or of a moment on a sheet, by the suffix of the file."""
RATES = {".mp4": 25.0, ".gif": 12.5}
SECONDS, HOLD, KINEMATIC_STEP = 10.0, 0.6, 0.1
"""How long a film is unless `steps` say otherwise, an episode after its goal is reached, a step of a task without a clock."""
MOMENTS, ROAMING, TELLING = 6, 40, 0.75
"""Moments on a sheet; the step of each where chance acts; and how far into its episode a task is shown among all."""
CRF, INK, GAP = 26, (60, 64, 70), 6
"""How coarsely a video is coded (18: nobody sees it); the colour of captions; pixels between moments."""


class Episode(NamedTuple):
    """States [n] from a start on, as NumPy arrays; the `last` step up to its goal, if that was `reached`, or else of all."""

    states: State
    last: int
    reached: bool

    def at(self, step: int) -> State:
        """Return one state, unbatched."""
        return jax.tree.map(operator.itemgetter(step), self.states)


class Cast(NamedTuple):
    """Who acts where: `choose(obs, line) -> action`, and the start of each episode with its `lines [n, a]`."""

    env: Env
    acting: str
    choose: Callable[[jax.Array, jax.Array], jax.Array]
    begin: Callable[[int], tuple[State, np.ndarray]]


def render(
    source: str | Path,
    out: str | Path | None = None,
    acting: str | None = None,
    seed: int = 0,
    steps: int | None = None,
    size: tuple[int, int] | None = None,
    fps: float | None = None,
    camera: str | None = None,
    progress: bool = False,
) -> Path:
    """Return the file that shows episodes of `source`, each from s0 with a goal of its own, as fast as they would be seen.

    Args:
        source: a run folder, a task's name, or `all` for a moment of each of the paper's six tasks (.png).
        out: .mp4, .gif or .png, a sheet of six moments; by default `video.mp4` in a run folder, else `TASK.mp4` (`all.png`).
        acting: one of `ACTINGS`; by default the policy of a run, else the first that the task has.
        seed: of starts and goals; in a run folder also which lane's policy acts.
        steps: control steps in all; by default ten seconds of them, on a sheet at most one episode.
        size: height and width of a frame, or of one moment.
        fps: frames a second at most; how many exactly follows from the task's control step.
        camera: one of the task's cameras.
        progress: show a bar.

    Raises:
        ValueError: an unknown source, suffix, acting or camera, one that the source does not have, or a missing library.
    """
    path = _target(source, out)
    height, width = size or SIZES[path.suffix]
    double = (2 * height, 2 * width)  # sheets are drawn so and shrunk, for smooth edges
    for name, value in (("steps", steps), ("fps", fps)):
        if value is not None and value <= 0:
            raise ValueError(f"{name} must be above 0, not {value}")
    if path.suffix == ".mp4" and (height % 2 or width % 2):
        raise ValueError(f"a video needs an even height and width, not {height} and {width}")
    _library("mediapy" if path.suffix == ".mp4" else "PIL")  # before there is work to lose
    if str(source) == ALL:
        casts = [cast_of(name, acting, seed) for name in SIX]
        return _write_sheet(path, _watched(_portraits(casts, double), len(casts), progress), columns=3)
    cast = cast_of(source, acting, seed)
    if path.suffix == ".png":
        with Scene(cast.env, double, camera) as scene:
            return _write_sheet(path, _watched(_moments(cast, scene, steps), MOMENTS, progress), columns=MOMENTS)
    seconds = step_seconds(cast.env)
    stride = max(1, round(1 / ((fps or RATES[path.suffix]) * seconds)))
    states = list(_frames(cast, steps or round(SECONDS / seconds), stride))
    with Scene(cast.env, (height, width), camera) as scene:
        images = (scene.image(state) for state in _watched(states, len(states), progress))
        return _write_film(path, images, 1 / (stride * seconds), (height, width))


def _target(source: str | Path, out: str | Path | None) -> Path:
    """Return where the picture of `source` goes."""
    suffixes = [".png"] if str(source) == ALL else SIZES
    path = Path(out or (Path(source) / "video.mp4" if _is_run(source) else f"{source}{next(iter(suffixes))}"))
    if path.suffix not in suffixes:
        raise ValueError(f"{path} has the suffix {path.suffix!r}; for {source} choose from {', '.join(suffixes)}")
    return path


def _is_run(source: str | Path) -> bool:
    return (Path(source) / "config.json").is_file()


def step_seconds(env: Env) -> float:
    """Return the seconds of a control step of `env`."""
    task = env.task if isinstance(env, HelpBudget) else env
    return getattr(task, "control_step", KINEMATIC_STEP)


def cast_of(source: str | Path, acting: str | None = None, seed: int = 0) -> Cast:
    """Return who acts in `source`, a run folder or a task, on the C engine where there is physics. Errors as `render`."""
    if acting is not None and acting not in ACTINGS:
        raise ValueError(f"unknown acting {acting!r}; choose from {', '.join(ACTINGS)}")
    run = _is_run(source)
    if not run and str(source) not in list_envs():
        raise ValueError(f"{source} is neither a run folder nor a task; the tasks are {', '.join(list_envs())}")
    env, policy = _learnt(Path(source), seed) if run else (make(str(source)), None)
    actors = _actors(env if env.engine == "kinematic" else with_physics(env, "c"), policy, seed)
    chosen = acting or next(iter(actors))
    if chosen not in actors:
        raise ValueError(f"{source} has no acting {acting!r}; choose from {', '.join(actors)}")
    return actors[chosen]


def _learnt(folder: Path, lane: int) -> tuple[Env, Policy]:
    env, method, lanes = load_lanes(RunFolder.open(folder))
    try:
        return env, Policy.of(env, select_seed(method, lane), select_seed(lanes, lane))
    except IndexError as error:
        raise ValueError(f"{folder}: {error}") from error


def _actors(env: Env, policy: Policy | None, seed: int) -> dict[str, Cast]:
    """Return every cast that there is for `env`, the one to prefer first."""
    none = np.zeros((env.eval_horizon, env.action_size), np.float32)

    def start(number: int) -> State:
        return env.reset(jax.random.fold_in(jax.random.key(seed), number))

    def chance(number: int) -> tuple[State, np.ndarray]:
        return start(number), np.random.default_rng([seed, number]).uniform(-1, 1, none.shape).astype(np.float32)

    actors = {}
    if policy is not None:
        actors["policy"] = Cast(env, "policy", lambda obs, line: policy(obs), lambda number: (start(number), none))
    with contextlib.suppress(ValueError):
        jax.eval_shape(env.expert, jax.ShapeDtypeStruct((env.obs_size,), jnp.float32))
        actors["expert"] = Cast(env, "expert", lambda obs, line: env.expert(obs), lambda number: (start(number), none))
    with contextlib.suppress(ValueError):
        actors["demos"] = Cast(env, "demos", lambda obs, line: line, _replayed(env, seed))
    return {**actors, "random": Cast(env, "random", lambda obs, line: line, chance)}


def _replayed(env: Env, seed: int) -> Callable[[int], tuple[State, np.ndarray]]:
    """Return how the episodes begin that do again what the forward demonstrations of `env` did; none are a ValueError."""
    demos = env.demos("forward")
    stops = np.flatnonzero(demos.ends) + 1
    starts, lengths = np.append(0, stops[:-1]), np.diff(stops, prepend=0)

    def begin(number: int) -> tuple[State, np.ndarray]:
        which = (seed + number) % len(stops)
        first, length = starts[which], lengths[which]
        lines = np.zeros((lengths.max(), env.action_size), np.float32)
        lines[:length] = demos.actions[first : first + length]
        return env.state_from_demo(jnp.asarray(demos.states[first]), jnp.asarray(demos.goals[first])), lines

    begin(0)  # some tasks cannot begin so
    return begin


def episodes(cast: Cast) -> Iterator[Episode]:
    """Yield what `cast` plays, one episode after the other without end, each `HOLD` longer than it takes to its goal."""
    env = cast.env

    @jax.jit
    def played(start: State, lines: jax.Array) -> State:
        def step(state: State, line: jax.Array) -> tuple[State, State]:
            after = env.step(state, cast.choose(state.obs, line))
            return after, after

        states = jax.lax.scan(step, start, lines)[1]
        return jax.tree.map(lambda first, rest: jnp.concatenate([jnp.asarray(first)[None], rest]), start, states)

    for number in range(2**31):
        states = jax.device_get(played(*cast.begin(number)))
        done = np.flatnonzero(states.metrics["success"][1:])
        last = int(done[0]) + 1 if len(done) else len(states.reward) - 1
        watched = operator.itemgetter(slice(last + round(HOLD / step_seconds(env)) + 1))
        yield Episode(jax.tree.map(watched, states), last, len(done) > 0)


def _frames(cast: Cast, steps: int, stride: int) -> Iterator[State]:
    """Yield every `stride`-th state of the episodes that fill `steps`."""
    for episode in episodes(cast):
        yield from (episode.at(number) for number in range(0, min(len(episode.states.reward), steps + 1), stride))
        steps -= len(episode.states.reward) - 1
        if steps <= 0:
            return


def _moments(cast: Cast, scene: Scene, steps: int | None) -> Iterator[tuple[np.ndarray, str]]:
    """Yield six moments with their captions: of one episode up to its goal, or where chance acts of six episodes."""
    acts, seconds = episodes(cast), step_seconds(cast.env)
    if cast.acting == "random":
        shots = [(f"start {number}, ", next(acts), steps or ROAMING) for number in range(1, MOMENTS + 1)]
    else:
        episode = next(acts)
        last = min(episode.last, steps or episode.last)
        shots = [("", episode, round(step)) for step in np.linspace(0, last, MOMENTS)]
    for label, episode, step in shots:
        step = min(step, len(episode.states.reward) - 1)
        there = ", goal reached" * (episode.reached and step == episode.last)
        yield scene.image(episode.at(step)), f"{label}{step * seconds:.1f} s{there}"


def _portraits(casts: list[Cast], size: tuple[int, int]) -> Iterator[tuple[np.ndarray, str]]:
    """Yield a telling moment of each of `casts` with the task's name."""
    for cast in casts:
        episode = next(episodes(cast))
        step = ROAMING if cast.acting == "random" else round(TELLING * episode.last)
        with Scene(cast.env, size) as scene:
            yield scene.image(episode.at(step)), cast.env.name


def _watched(things: Iterable[Any], total: int, show: bool) -> Iterable[Any]:
    """Return `things`, behind a bar on stderr if `show` and that is a terminal."""
    console = Console(stderr=True, quiet=not show)
    return track(things, "drawing", total, console=console, transient=True, disable=not console.is_terminal)


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ValueError(f"pictures need {name.partition('.')[0]}: pip install 'earl-jax[render]'") from error


@contextlib.contextmanager
def _written(path: Path) -> Iterator[Path]:
    """Give a file beside `path` to write to, which takes its place once it is whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _write_film(path: Path, images: Iterable[np.ndarray], fps: float, size: tuple[int, int]) -> Path:
    """Write `images` at `fps` to a .mp4 or .gif and return it."""
    if path.suffix == ".gif":
        first, *rest = [_library("PIL.Image").fromarray(image).quantize(128, dither=0) for image in images]
        with _written(path) as part:
            first.save(part, save_all=True, append_images=rest, duration=round(1000 / fps), problem=0, optimize=True)
        return path
    mediapy = _library("mediapy")
    mediapy.set_ffmpeg(_library("imageio_ffmpeg").get_ffmpeg_exe())
    with _written(path) as part, mediapy.VideoWriter(part, size, fps=fps, crf=CRF) as video:
        for image in images:
            video.add_image(image)
    return path


def _write_sheet(path: Path, shots: Iterable[tuple[np.ndarray, str]], columns: int) -> Path:
    """Write images drawn at twice their size, with their captions below, in rows of `columns`, to a .png; return it."""
    image, draw, fonts = (_library(f"PIL.{name}") for name in ("Image", "ImageDraw", "ImageFont"))
    pictures = [(image.fromarray(pixels).reduce(2), text) for pixels, text in shots]
    width, height = pictures[0][0].size
    font = fonts.load_default(max(10, height / 14))
    across, down = width + GAP, height + round(1.7 * font.size)
    sheet = image.new("RGB", (columns * across - GAP, -(-len(pictures) // columns) * down), "white")
    pen = draw.Draw(sheet)
    for number, (picture, text) in enumerate(pictures):
        x, y = number % columns * across, number // columns * down
        sheet.paste(picture, (x, y))
        pen.text((x + width / 2, y + (height + down) / 2), text, INK, font, anchor="mm")
    with _written(path) as part:
        sheet.quantize(256, kmeans=3).save(part, optimize=True)
    return path
