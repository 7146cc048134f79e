"""Names of the package, of installed packages, and of registered classes."""

import inspect
import sys

import pytest

import earl_jax
from earl_jax import SAC, Learner, envs
from earl_jax.adapters.earl_benchmark import ORIGINAL_NAMES
from earl_jax.envs.tabletop import TabletopOrganization
from earl_jax.options.registry import ARGUMENTS, Registry
from tests.conftest import write_files

MEADOW = """
import dataclasses
from earl_jax.envs.tabletop import TabletopOrganization

class Meadow(TabletopOrganization):
    name = "meadow"
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Return a function that puts a package on the path and returns a registry that sees it.

    `entry_points` are those of envs; `source` is the text of its module `theirs`.
    """

    def install(entry_points, source="", name="Their_Package"):
        lines = "".join(f"{key} = {value}\n" for key, value in entry_points.items())
        files = {
            f"{name}-0.1.0.dist-info/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n",
            f"{name}-0.1.0.dist-info/entry_points.txt": f"[earl_jax.envs]\n{lines}",
            "theirs.py": source,
        }
        write_files(files, tmp_path / name)
        monkeypatch.delitem(sys.modules, "theirs", raising=False)
        monkeypatch.syspath_prepend(tmp_path / name)
        return Registry("env", "earl_jax.envs.base:Env", {"sawyer_door": "earl_jax.envs.sawyer.door:SawyerDoor"})

    return install


def test_the_names_of_a_package_are_listed_and_built(install):
    registry = install({"meadow": "theirs:Meadow"}, MEADOW)
    assert registry.names() == ["meadow", "sawyer_door"]
    assert registry.make("meadow", wide=True).wide
    registry.register("meadow", type(registry.make("meadow")))  # a script may name what its package has named
    with pytest.raises(ValueError, match="'meadow' already exists, in Their_Package"):
        registry.register("meadow", SAC)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("import shepherds", "of Their_Package 0.1.0 cannot be loaded: ModuleNotFoundError: No module named 'shepherds'"),
        ("1 / 0", "of Their_Package 0.1.0 cannot be loaded: ZeroDivisionError"),
        ("", "of Their_Package 0.1.0 cannot be loaded: AttributeError.*Meadow"),
        (MEADOW.replace('"meadow"', '"lawn"'), "theirs:Meadow of Their_Package 0.1.0 has the name 'lawn'"),
        (
            "def Meadow(): ...",
            "theirs:Meadow of Their_Package 0.1.0 must be a dataclass and a subclass of Env, not <function Meadow",
        ),
        (
            "from earl_jax.algos import SAC as Meadow",
            "theirs:Meadow of Their_Package 0.1.0 must be a dataclass and a subclass of Env, not <class '.*SAC'>",
        ),
    ],
    ids=["import fails", "module fails", "no class", "another name", "no class but a function", "another kind"],
)  # fmt: skip
def test_a_broken_package_is_listed_and_is_an_error_when_its_name_is_used(install, source, message):
    registry = install({"meadow": "theirs:Meadow"}, source)
    assert registry.names() == ["meadow", "sawyer_door"]
    assert registry.get("sawyer_door").name == "sawyer_door"
    with pytest.raises(ValueError, match=f"task 'meadow'.*{message}"):
        registry.get("meadow")


def test_an_unknown_name_says_what_it_may_mean_and_how_to_name_a_class_of_ones_own(install):
    message = r"^unknown task 'maze'; choose from meadow, sawyer_door \(your own: --import FILE"
    with pytest.raises(ValueError, match=message):
        install({"meadow": "theirs:Meadow"}).get("maze")
    for name, own in {**ORIGINAL_NAMES, "bulb": "dhand_lightbulb", "Door": "sawyer_door"}.items():
        message = f"^unknown task '{name}'; did you mean '{own}'\\? Choose from cheetah_run"
        with pytest.raises(ValueError, match=message):
            envs.make(name)
    with pytest.raises(ValueError, match=r"^unknown method 'FBRL'; did you mean 'fbrl'\?"):
        earl_jax.make_algo("FBRL")
    with pytest.raises(ValueError, match=r"^unknown method Naive\(.{,40}; choose from"):
        earl_jax.make_algo(earl_jax.make_algo("naive"))  # pyright: ignore[reportArgumentType]


def test_a_name_claimed_twice_is_an_error_that_names_both_owners(install):
    registry = install({"sawyer_door": "theirs:Meadow", "meadow": "theirs:Meadow"}, MEADOW)
    assert registry.names() == ["meadow", "sawyer_door"]
    with pytest.raises(ValueError, match=r"'sawyer_door' is claimed by earl_jax and Their_Package 0\.1\.0; rename"):
        registry.get("sawyer_door")
    assert registry.get("meadow").name == "meadow"
    registry = install({"meadow": "theirs:Meadow"}, MEADOW, name="Others")
    with pytest.raises(ValueError, match=r"'meadow' is claimed by Others 0\.1\.0 and Their_Package 0\.1\.0"):
        registry.get("meadow")


def test_a_class_is_registered_under_its_own_name_and_with_its_own_kind_only():
    registry = Registry("env", "earl_jax.envs.base:Env", {})
    with pytest.raises(ValueError, match="the registered class has the name 'tabletop_organization'"):
        registry.register("table", type(envs.make("tabletop_organization")))
    for name in ("my/table", "../table", "my table", "2nd_table"):  # no folder or no id of Gymnasium
        with pytest.raises(ValueError, match=r"a name has letters, digits, _, - and \. only, and begins with a letter"):
            registry.register(name, type("Table", (TabletopOrganization,), {"name": name}))
    with pytest.raises(ValueError, match="the registered class must be a dataclass and a subclass of Env, not <class"):
        registry.register("sac", SAC)
    registry = Registry("learner", "earl_jax.algos.learner.base:Learner", {})
    with pytest.raises(ValueError, match="learner 'half': the registered class lacks act, greedy, init, update"):
        registry.register("half", type("Half", (Learner,), {"name": "half"}))
    own = type("Own", (SAC,), {"name": "own", "eval_every": 1, "__annotations__": {"eval_every": int}})
    with pytest.raises(ValueError, match="has an option named like an argument of train, eval_every; rename it"):
        registry.register("own", own)
    plain = type("Plain", (TabletopOrganization,), {"name": "plain", "width": 1.0, "__annotations__": {"width": float}})
    with pytest.raises(
        ValueError, match=r"width would be no option of .*; decorate Plain with @dataclasses\.dataclass"
    ):
        Registry("env", "earl_jax.envs.base:Env", {}).register("plain", plain)
    assert registry.names() == []
    parameters = inspect.signature(earl_jax.train).parameters
    assert {*parameters, "name"} - {"engine", "options"} == ARGUMENTS


def test_a_class_that_a_cell_defines_again_takes_the_place_of_the_earlier_one():
    """A name that stayed with the earlier class trained the code that the cell no longer had."""
    registry = Registry("env", "earl_jax.envs.base:Env", {})
    for wide in (True, False):
        cell = {"__name__": "__main__"}
        exec(MEADOW + f"    wide: bool = {wide}\n", cell)
        registry.register("meadow", cell["Meadow"])
    assert registry.get("meadow") is cell["Meadow"]
    with pytest.raises(ValueError, match="'meadow' already exists"):
        registry.register("meadow", type("Meadow", (cell["Meadow"],), {"__module__": "theirs"}))
