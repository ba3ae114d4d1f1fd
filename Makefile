# insemu: `make demo` sets everything up and runs the main job; `make test` sets everything up and passes the tests.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
WORKERS ?= 2
STAMP := $(VENV)/.installed

# Containers often ask Python to keep no compiled modules; then each start compiles 1,500 of them again, 4 s.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-slow test-target scoreboard scoreboard-release claims claims-nightly lint bench docs links setup smoke wheel lock clean

demo: $(STAMP)
	$(BIN)/insemu run scenarios/table3_synthetic.yaml --workers $(WORKERS) --output results/table3_synthetic

test: $(STAMP)
	$(BIN)/python -m pytest -m "not slow" -n $(WORKERS) --dist worksteal

test-slow: $(STAMP)
	$(BIN)/python -m pytest -m slow -n $(WORKERS)

# The quick tests, or some, with the arithmetic of another processor: TARGET=generic, x86-64-v2, x86-64-v3, skylake-avx512.
TARGET ?= generic
TESTS ?=
test-target: $(STAMP)
	.ci/target.sh $(TARGET) $(BIN)/python -m pytest -m "not slow" -n $(WORKERS) --dist worksteal $(TESTS)

# Fixed blind recordings against tests/scoreboard.yaml, all or LIMIT of them: what moved, and failure where a score left its binomial bound.
LIMIT ?= 0
scoreboard: $(STAMP)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.scoreboard --workers $(WORKERS) --limit $(LIMIT)

scoreboard-release: $(STAMP)
	mkdir -p results && OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.scoreboard --release 1000 --workers $(WORKERS) --log results/scoreboard_release.jsonl

# The commands behind the figures of README and docs: the quick ones (CI), or all of them (every night); fails where a figure is not printed any more.
claims: $(STAMP)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.claims --run cheap

claims-nightly: $(STAMP)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.claims --run all

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(STAMP)
	for file in benchmarks/[a-z]*.py; do $(BIN)/python $$file || exit 1; done

docs: $(STAMP)
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs site

# A short run of every scenario.
smoke: $(STAMP)
	out=$$(mktemp -d) && trap 'rm -rf "$$out"' EXIT && $(BIN)/python .ci/smoke.py "$$out" $(WORKERS)

# With compiled kernels for this machine's baseline, or for PROCESSORS="x86-64-v3 generic"; tested, then in dist/.
PROCESSORS ?=
wheel: $(STAMP)
	.ci/wheel.sh $(BIN)/python $(PROCESSORS)

# Every link of the pages to other sites, which CI without a network cannot ask for.
links: $(STAMP)
	$(BIN)/python -m sphinx -q -b linkcheck docs site/links

# Installs; kernels are compiled once, by what uses them first.
setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit("insemu needs Python 3.11 or newer, found " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt --editable ".[dev,docs,cluster,files]"
	touch $@

# Renew the versions that were tested: install without constraints in a fresh environment, run the tests, then write what was there.
lock:
	rm -rf .venv-lock && $(PYTHON) -m venv .venv-lock
	.venv-lock/bin/python -m pip install --quiet --editable ".[dev,docs,cluster,files]"
	.venv-lock/bin/python -m pip freeze --exclude-editable --exclude insemu > constraints.txt
	.venv-lock/bin/python .ci/hashes.py
	rm -rf .venv-lock

clean:
	rm -rf $(VENV) .venv-ci .kernels site docs/reference results/table3_synthetic results/real_static
