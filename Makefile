# Two commands do everything on a fresh machine: `make demo` and `make test`. `make help` lists the rest.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
JOBS ?= 2

.DEFAULT_GOAL := help
.PHONY: help setup demo test fuzz coverage lint types docs docs-serve pictures clean

help:  ## List the commands
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-10s %s\n", $$1, $$2}'

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "prgbd needs Python 3.11 or later; run 'make PYTHON=python3.11 ...'."; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

setup: $(STAMP)  ## Make .venv and install prgbd with its tools into it

demo: $(STAMP)  ## Run the self-improving loop on a held-out synthetic world and write a report
	$(BIN)/python -m prgbd +slam=orb_gtsam +depth=monodepth2 experiment=demo

# No test is left out for want of an extra: about 300 MB of downloads, small beside PyTorch. The demo does without them.
$(VENV)/.extras: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev,colmap,docs,hf,viz]'
	@touch $@

test: $(VENV)/.extras  ## Run the tests, after adding all extras
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile

fuzz: $(VENV)/.extras  ## Try some thousand damaged and hostile inputs, other ones each time (10 minutes)
	PRGBD_FUZZ=large $(BIN)/python -m pytest -n $(JOBS) --dist worksteal tests/robustness

coverage: $(VENV)/.extras  ## Run the tests and print how much of the Python code they execute
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile --cov --cov-report=term:skip-covered

lint: $(STAMP)  ## Check style, spelling and the direction of imports
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell
	$(BIN)/lint-imports

types: $(STAMP)  ## Check types
	$(BIN)/mypy

# MkDocs is no part of the tests' environment; it is added once. The variable silences an announcement, not a warning.
$(VENV)/.docs: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@

docs: $(VENV)/.docs  ## Build the documentation into site/ (index.html); any warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo "Open site/index.html in a browser (the search field needs a server: make docs-serve)."

docs-serve: $(VENV)/.docs  ## Show the documentation at http://127.0.0.1:8000 while you write
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs serve

pictures: $(STAMP)  ## Take the pictures of the documentation from a demo run: make pictures RUN=outputs/DATE/TIME
	$(BIN)/python docs/pictures.py $(RUN)

clean:  ## Remove the environment and everything generated
	rm -rf $(VENV) outputs multirun build dist site *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .coverage*
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
