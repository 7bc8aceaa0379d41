# The two commands: `make repro` computes everything, `make test` checks everything. Each makes .venv if it is missing.
PYTHON ?= python3
export PATH := $(CURDIR)/.venv/bin:$(PATH)
export PYTHONDONTWRITEBYTECODE :=

.PHONY: repro test pictures install

install: .venv/installed

.venv/installed: requirements.lock pyproject.toml
	$(PYTHON) -m venv .venv
	.venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch .venv/installed

repro: install
	lessbench recover
	dvc repro
	lessbench summary

test: install
	ruff check .
	ruff format --check .
	mypy
	lint-imports
	pytest -q

# the pictures of README and docs, from what `make repro` computed
pictures: install
	python docs/make_pictures.py
