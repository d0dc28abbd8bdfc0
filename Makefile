# PlaceBench: every command makes the environment first and re-installs only when the pins change.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
PY := $(VENV)/bin/python
INSTALLED := $(VENV)/.installed
TIER ?= mini
WORKERS ?= $(shell env -u OMP_NUM_THREADS nproc)
# A dataset of your own: CATALOGUE=objects.toml, RECIPE=recipe.toml or both; DATA=folder (data/own/NAME, and data for the benchmark).
OWN := $(or $(CATALOGUE),$(RECIPE))
ROOT := $(or $(DATA),$(if $(OWN),data/own/$(basename $(notdir $(OWN))),data))
RELEASE ?= $(ROOT)/release/$(TIER)
OF_RECIPE := $(if $(RECIPE),--recipe $(RECIPE))
REPORTS := $(if $(filter data,$(ROOT)),,$(ROOT)/reports/$(TIER))
DATASET := $(if $(CATALOGUE),--catalogue $(CATALOGUE)) $(OF_RECIPE) $(if $(DATA),--data $(DATA))
$(foreach file,$(CATALOGUE) $(RECIPE),$(if $(wildcard $(file)),,$(error $(file): no such file)))

export DAGSTER_HOME := $(abspath $(if $(filter data,$(ROOT)),.dagster_home,$(ROOT)/.dagster_home))
export PYTHONUNBUFFERED := 1
# One thread a process: units of work are the parallelism.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
# The same kernels on every processor, so the same bits (tables/__init__.py).
export OPENBLAS_CORETYPE := Haswell

.PHONY: demo dataset ui reports figures films site light rankers curve replicates points plans rejections test soak check bench reproduce validity knobs clean

demo: $(INSTALLED)  ## the whole benchmark on tier mini, from objects to reports
	$(PY) -m assets_def.build mini --workers $(WORKERS) $(DATASET)

dataset: $(INSTALLED)  ## a tier's dataset and reports: only what is missing or outdated, resumable (TIER=mini|pilot|full; CATALOGUE, RECIPE, DATA)
	$(PY) -m assets_def.build $(TIER) --workers $(WORKERS) $(DATASET)

ui: $(INSTALLED)  ## the Dagster UI on this checkout, or on a dataset of your own (CATALOGUE, RECIPE, DATA)
	$(PY) -m assets_def.ui $(DATASET)

reports: $(INSTALLED)  ## every report from a release and the tables about it, nothing labelled or trained (TIER, or RELEASE=folder; SPLIT=scheme)
	$(PY) -m reports.all $(RELEASE) $(if $(SPLIT),--split $(SPLIT)) $(OF_RECIPE) $(if $(REPORTS),--out $(REPORTS)$(if $(SPLIT),/$(SPLIT)))

figures: $(INSTALLED)  ## the pictures of the README and of the site's first page, into reports/pictures (a minute of a core)
	$(PY) -m reports.front_page data/release/full

films: $(INSTALLED)  ## two films and traces of every outcome and category, for the site (about ten seconds of a core each; TIER, or RELEASE=folder)
	$(PY) -m reports.sample_films $(RELEASE) $(OF_RECIPE) $(if $(REPORTS),--out $(REPORTS)/films)

site: $(INSTALLED)  ## the results of a release as static pages: reports/out/$(TIER)/site/index.html, from its reports and films (TIER, or RELEASE=folder)
	$(PY) -m reports.site $(RELEASE) $(if $(REPORTS),--reports $(REPORTS))

light: $(INSTALLED)  ## a copy of a tier's release without its heavy tables, in $(RELEASE)-light
	$(PY) -m splits.release light $(RELEASE) $(RELEASE)-light

rankers: $(INSTALLED)  ## rankers of a release, as far as they are neither shipped nor trained, and their predictions beside it (TIER; ONLY="local full.42"; SPLIT=scheme)
	$(PY) -m assets_def.rankers $(TIER) --workers $(WORKERS) $(if $(ONLY),--only $(ONLY)) $(if $(SPLIT),--split $(SPLIT))

curve: $(INSTALLED)  ## S1 by training scenes: trains rankers on some of them, for the learning_curve report (TIER; ONLY=variants)
	$(PY) -m assets_def.learning_curve $(TIER) --workers $(WORKERS) $(if $(ONLY),--only $(ONLY))

replicates: $(INSTALLED)  ## planned test candidates executed again under small real uncertainty, for the ceiling report; resumable (SCENES=80: so many scenes, to which a later run adds)
	$(PY) -m splits.replicates $(RELEASE) --workers $(WORKERS) $(if $(SCENES),--scenes $(SCENES)) $(OF_RECIPE)

points: $(INSTALLED)  ## heavy tables of a light release again, hash-checked (RELEASE=folder, data/release/$(TIER) by default)
	$(PY) -m splits.rebuild $(RELEASE) points --workers $(WORKERS) $(OF_RECIPE)

plans: $(INSTALLED)
	$(PY) -m splits.rebuild $(RELEASE) plans --workers $(WORKERS) $(OF_RECIPE)

rejections: $(INSTALLED)
	$(PY) -m splits.rebuild $(RELEASE) rejections --workers $(WORKERS) $(OF_RECIPE)

test: $(INSTALLED)
	$(PY) -m pytest -m "not slow"

soak: $(INSTALLED)  ## the slow tests too
	$(PY) -m pytest

check: $(INSTALLED)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports
	$(VENV)/bin/dagster definitions validate -m assets_def.definitions

bench: $(INSTALLED)  ## what a label costs; writes reports/out/bench.json (about five minutes)
	$(PY) -m assets_def.bench

reproduce: $(INSTALLED)  ## equal tables for any number of workers, any order, and ids made alone (about five minutes)
	$(PY) -m pipelines.reproduce

validity: $(INSTALLED)  ## the held object's engine against theory, itself and another engine; writes reports/out/validity.json and .md (TIER=pilot; ONLY=study)
	$(PY) -m assets_def.validity $(if $(filter file,$(origin TIER)),pilot,$(TIER)) --workers $(WORKERS) $(if $(ONLY),--only $(ONLY)) --data $(ROOT) $(OF_RECIPE)

$(INSTALLED): pyproject.toml constraints.txt
	test -x $(PY) || $(PYTHON) -m venv $(VENV)
	$(PY) -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

knobs: $(INSTALLED)  ## what each knob of the recipe moves; writes reports/out/knobs.md (about 40 minutes, resumable)
	$(PY) -m assets_def.knobs --workers $(WORKERS)

clean:  ## generated data and reports; not the environment, and not what is shipped: data/release/full, data/predictions/full
	rm -rf reports/out
	find data -mindepth 1 -maxdepth 1 ! -name release ! -name predictions -exec rm -rf {} +
	find data/release data/predictions -mindepth 1 -maxdepth 1 ! -name full -exec rm -rf {} +
