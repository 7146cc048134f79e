# Two commands on a fresh machine: make quickstart, make test.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.lock
STAMP := $(VENV)/.installed
TOOLS := $(VENV)/.tools
OUT ?= runs/quickstart-$(shell date +%Y%m%d-%H%M%S)

.PHONY: quickstart test check demos lock clean

$(STAMP): pyproject.toml requirements.lock
	$(PYTHON) -m venv $(VENV)
	$(PIP) -e '.[plot]'
	touch $@

$(TOOLS): $(STAMP)
	$(PIP) -e '.[plot,test]'
	touch $@

quickstart: $(STAMP)
	$(BIN)/earl-jax quickstart --out $(OUT)

check: $(TOOLS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright --pythonpath $(BIN)/python

test: check
	$(BIN)/pytest -n 3 --dist loadfile --durations=10

# Exact versions for every supported Python, without an index address.
lock: $(STAMP)
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile pyproject.toml --universal --python-version 3.11 --extra plot --extra test --no-emit-index-url --no-header --no-annotate --upgrade -o requirements.lock

demos: $(STAMP)
	$(BIN)/earl-jax demos tabletop_organization --out assets/demos/tabletop_organization.npz
	$(BIN)/earl-jax demos sawyer_door --physics c --out assets/demos/sawyer_door.npz
	$(BIN)/earl-jax demos sawyer_peg --physics c --out assets/demos/sawyer_peg.npz

clean:
	rm -rf $(VENV) .cache
