# On a fresh machine: `make quickstart` trains a small agent, `make test` runs the tests. Both install into .venv first.
comma := ,
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.lock
UV := $(BIN)/uv pip install --quiet --system-certs --python $(BIN)/python -c requirements.lock
# uv takes a sixth of pip's CPU time; pip installs the same versions where uv is missing or reaches no index. Like pip, it trusts the
# certificates of the system, so that it also works behind a proxy with its own.
install = $(PIP) uv && $(UV) $(1) || $(PIP) $(1)
STAMP := $(VENV)/.installed
TOOLS := $(VENV)/.tools
MORE := $(VENV)/.more
QUICK := minari,plot,render,report,tensorboard,test
EXAMPLE := examples/cfbrl
ALL := $(QUICK),notebook,peers,wandb
NEWEST := .venv-newest
DOCS := .venv-docs
DOCS_EXTRA := import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["docs"], sep="\n")
UNBOUNDED := import re, tomllib; names = tomllib.load(open("pyproject.toml", "rb"))["project"]["dependencies"]; \
	print(*[re.split("[<>=!~;]", name)[0] for name in names], "hypothesis", "pytest", "pytest-xdist", sep="\n")
OUT ?= runs/quickstart-$(shell date +%Y%m%d-%H%M%S)

# uv leaves the bytecode to the first import, which must keep it for the processes after it.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: quickstart test test-slow test-newest check lint types pytest catalog demos docs notebooks lock clean

$(STAMP): pyproject.toml requirements.lock
	$(PYTHON) -m venv $(VENV)
	$(call install,-e '.[plot]')
	touch $@

$(TOOLS): $(STAMP) $(EXAMPLE)/pyproject.toml
	$(call install,-e '.[$(QUICK)]' -e $(EXAMPLE))
	touch $@

$(MORE): $(TOOLS)
	$(call install,-e '.[$(ALL)]')
	touch $@

quickstart: $(STAMP)
	$(BIN)/earl-jax quickstart --out $(OUT)

check: lint types

lint: $(TOOLS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(TOOLS)
	$(BIN)/pyright --pythonpath $(BIN)/python

# The type check takes half a minute on one core, so it runs beside the tests.
test: lint
	$(MAKE) --no-print-directory --jobs=2 types pytest

pytest: $(TOOLS)
	$(BIN)/pytest -m "not slow" -n 2 --dist loadfile --durations=10

# Slow tests and tests that need more packages: PyTorch learners, notebooks, a browser, a clean environment, killed processes.
# Run make test before.
test-slow: $(MORE)
	$(BIN)/pytest -m slow -n 2 --dist loadfile --durations=10

# The physics tests with the newest releases of all dependencies, without the lock file and without upper bounds. They show
# early what the next release breaks, so that the bounds in pyproject.toml can be raised or explained.
test-newest: pyproject.toml
	$(PYTHON) -m venv $(NEWEST)
	$(NEWEST)/bin/python -c '$(UNBOUNDED)' > $(NEWEST)/requirements.txt
	$(NEWEST)/bin/python -m pip install --quiet --disable-pip-version-check --upgrade -r $(NEWEST)/requirements.txt
	$(NEWEST)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	$(NEWEST)/bin/python -m pytest tests/physics -m "not slow" -n 2 --dist loadfile

# Exact versions for every supported Python, without the address of an index. The CUDA packages of PyTorch are left out, because
# jax needs another version.
lock: $(STAMP)
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile pyproject.toml --universal --python-version 3.11 $(addprefix --extra ,$(subst $(comma), ,$(ALL),docs)) \
		--no-emit-index-url --no-header --no-annotate --upgrade -o requirements.lock
	sed -i -E '/^(cuda|nvidia|triton)/d' requirements.lock

# The site of the documentation, in the folder site; an error for any broken link. It imports nothing of the package, so it has an
# environment of its own without jax. python -m http.server -d site shows it, search included.
docs: $(DOCS)/.installed
	$(DOCS)/bin/python -m mkdocs build --strict

$(DOCS)/.installed: pyproject.toml requirements.lock
	$(PYTHON) -m venv $(DOCS)
	$(DOCS)/bin/python -c '$(DOCS_EXTRA)' > $(DOCS)/requirements.txt
	$(DOCS)/bin/python -m pip install --quiet --disable-pip-version-check -c requirements.lock -r $(DOCS)/requirements.txt
	touch $@

# The notebooks of notebooks/*.py with their outputs, for the site: about 35 minutes on two quiet cores.
notebooks: $(MORE)
	$(BIN)/python -m docs.site.notebooks --execute

demos: $(STAMP)
	$(BIN)/earl-jax demos tabletop_organization --out assets/demos/tabletop_organization.npz
	$(BIN)/earl-jax demos sawyer_door --engine c --out assets/demos/sawyer_door.npz
	$(BIN)/earl-jax demos sawyer_peg --engine c --out assets/demos/sawyer_peg.npz

catalog: $(STAMP)
	$(BIN)/python -c 'from earl_jax.cli import descriptions; descriptions.store()'

clean:
	rm -rf $(VENV) $(NEWEST) $(DOCS) .cache site
