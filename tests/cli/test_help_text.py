"""Tests of the help: what values are called, defaults in words, paragraphs without breaks."""

import re

import pytest

from earl_jax.cli.main import COMMANDS
from tests.cli.process import run


@pytest.mark.parametrize("command", COMMANDS)
def test_help_says_defaults_and_values_in_words(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    code, page, _ = run(command, "--help")
    assert (code, f"usage: earl-jax {command}" in page) == (0, True)
    assert not re.search(r"None|\(default: \)|\[\[|\bSTR\b|\.\.\.\]\]|\|\{", page)


def test_help_lists_the_commands():
    commands = [
        "list", "train", "resume", "sweep", "search", "reproduce", "evaluate", "plot", "table", "best", "compare", "render",
        "report", "demos", "import-demos", "quickstart",
    ]  # fmt: skip
    code, page, _ = run("--help")
    assert code == 0
    assert sorted(commands) == sorted(COMMANDS)
    assert [command for command in commands if command not in page] == []


@pytest.mark.parametrize(
    ("command", "usage", "options"),
    [
        (
            "train",
            "[TASK]",
            ["--algo METHOD", "--seeds SEEDS", "--set NAME=VALUE ...", "--log {tensorboard,wandb} ..."],
        ),
        ("resume", "RUN", ["--steps INT"]),
        ("plot", "FOLDER ...", ["--labels NAME ...", "--metric COLUMN", "--out PATH", "--size {screen,column,page}"]),
        ("table", "FOLDER ...", ["--labels NAME ..."]),
        ("sweep", "FILE", ["--slurm NAME=VALUE ...", "--per-device INT|auto", "--minutes MINUTES"]),
        ("list", "[NAME]", []),
        ("demos", "TASK", ["--engine ENGINE"]),
    ],
)
def test_values_have_the_names_of_what_they_are(command, usage, options, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    first, *rest = run(command, "--help")[1].splitlines()
    assert usage in first
    assert [option for option in options if not any(line.lstrip("│ ").startswith(option) for line in rest)] == []


def test_a_paragraph_of_help_has_no_break(monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    assert "or a list such as 3 5 8. By default 5, or those of --config" in run("train", "--help")[1]
