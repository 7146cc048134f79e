import jax
import pytest
from flax import struct

from earl_jax.algos.learner.sac import SAC
from earl_jax.algos.learner.td3 import TD3
from earl_jax.algos.naive import Naive
from earl_jax.algos.oracle import Oracle
from earl_jax.algos.pytree import OptionsNode


class Options(OptionsNode):
    rate: float = 0.5
    size: int = struct.field(pytree_node=False, default=2)


@pytest.mark.parametrize("base", [Options, Naive, Oracle, SAC, TD3])
def test_a_class_with_the_fields_of_another_has_a_structure_of_its_own(base):
    """`jax.jit` would now and then run the program of the other class."""
    former, latter = (type(base.__name__, (base,), {})() for _ in range(2))
    structures = [jax.tree.structure(options) for options in (base(), former, latter)]
    assert [structure == other for structure in structures for other in structures].count(True) == 3
    assert jax.tree.structure(latter) == jax.tree.structure(type(latter)())


def test_static_fields_belong_to_the_structure_and_the_others_are_leaves():
    options = Options(size=3)
    [(path, leaf)], structure = jax.tree_util.tree_flatten_with_path(options)
    assert (jax.tree_util.keystr(path), leaf) == (".rate", 0.5)
    assert structure != jax.tree.structure(Options())
    assert jax.tree.map(lambda rate: 2 * rate, options) == Options(rate=1.0, size=3)
    assert options.replace(size=2) == Options()
    with pytest.raises(AttributeError):
        options.rate = 1.0


def test_a_list_with_a_number_for_each_lane_is_one_leaf():
    """Jax used to take it apart, which ended in an error of its own."""
    [leaf] = jax.tree.leaves(Options(rate=[0.2, 0.8]))  # pyright: ignore[reportArgumentType]
    assert leaf.tolist() == [0.2, 0.8]


def test_a_field_that_autoreload_has_added_keeps_its_value():
    """It had its default in a program: the fields were those with which the class was first defined."""

    class Former(OptionsNode):
        rate: float = 0.5

    class Latter(OptionsNode):
        rate: float = 0.5
        bonus: float = 1.0

    for name in ("__dataclass_fields__", "__init__", "__eq__"):  # as `%autoreload` changes a class in place
        setattr(Former, name, vars(Latter)[name])
    assert jax.tree.map(lambda leaf: 2 * leaf, Former(bonus=50.0)).bonus == 100.0
