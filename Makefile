# The two commands: `make repro` computes everything, `make test` checks everything. Each makes .venv if it is missing:
# `make repro` with what the pipeline needs, `make test` with the test tools besides.
PYTHON ?= python3
export PATH := $(CURDIR)/.venv/bin:$(PATH)
export PYTHONDONTWRITEBYTECODE :=

# without bytecode, which Python makes of what it imports when it first does: a tenth of the size otherwise
PIP = .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-compile
RUN_LOCK = requirements.lock
TEST_LOCKS = requirements-cluster.lock requirements-dev.lock

.PHONY: repro test docs pictures install install-dev locks

install: .venv/installed
install-dev: .venv/installed-dev

.venv/installed: $(RUN_LOCK) pyproject.toml
	$(PYTHON) -m venv .venv
	$(PIP) --require-hashes $(RUN_LOCK:%=-r %)
	$(PIP) --no-deps --no-build-isolation --editable .
	touch $@

.venv/installed-dev: .venv/installed $(TEST_LOCKS)
	$(PIP) --require-hashes $(RUN_LOCK:%=-r %) $(TEST_LOCKS:%=-r %)
	touch $@

repro: install
	lessbench recover
	dvc repro
	lessbench summary

test: install-dev
	ruff check .
	ruff format --check .
	mypy
	lint-imports
	pytest -q --numprocesses auto --dist loadscope --no-loadscope-reorder

# the documentation as a site in build/site, without the network
docs: install-dev
	python docs/make_site.py

# the pictures of README and docs, from what `make repro` computed
pictures: install
	python docs/make_pictures.py

# After a change of the dependencies in pyproject.toml; needs uv. Pins that still fit are kept: remove one to renew it.
LOCK = uv pip compile --quiet --universal --generate-hashes --no-header --no-annotate pyproject.toml
besides = $$(sed -nE 's/^([a-z0-9.-]+)==.*/--no-emit-package \1/p' $(1)) $(1:%=--constraint %)
locks:
	echo "setuptools>=80" | $(LOCK) - --output-file $(RUN_LOCK)
	$(LOCK) --extra cluster $(call besides,$(RUN_LOCK)) --output-file requirements-cluster.lock
	$(LOCK) --extra cluster --extra ros --extra hdf5 --extra docs --extra dev $(call besides,$(RUN_LOCK) requirements-cluster.lock) --output-file requirements-dev.lock
	python docs/make_licences.py
