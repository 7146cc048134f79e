"""The help: what values are called, defaults in words, paragraphs without breaks."""

import re

import pytest

from earl_jax.cli.main import COMMANDS
from tests.cli.process import run

SHOWN = {
    "": [*COMMANDS, "--import FILE"],
    "list": ["[NAME]"],
    "train": [
        "[TASK]", "--algo METHOD", "--seeds SEEDS", "--set NAME=VALUE ...", "--log {tensorboard,wandb} ...",
        "or a list such as 3 5 8. By default 5, or those of --config",
    ],
    "plot": ["FOLDER ...", "--labels NAME ...", "--metric COLUMN", "--out PATH", "--size {screen,column,page}"],
    "render": ["SOURCE", "--size HEIGHT WIDTH"],
}  # fmt: skip


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_names_commands_and_values_and_says_defaults_in_words(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    code, page, _ = run(*filter(None, [command]), "--help")
    assert (code, f"usage: earl-jax {command}" in page) == (0, True)
    assert not re.search(r"None|\(default: \)|\[\[|\bSTR\b|\.\.\.\]\]|\|\{", page)
    assert [text for text in SHOWN.get(command, ()) if text not in page] == []


def test_the_help_of_a_narrow_terminal_is_that_of_forty_columns(monkeypatch):
    pages = {}
    for columns in (40, 20, 10, 5, 1):
        monkeypatch.setenv("COLUMNS", str(columns))
        pages[columns] = run("list", "--help")
    assert pages[40][0] == 0
    assert [columns for columns, page in pages.items() if page != pages[40]] == []
