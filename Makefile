# Targets: demo, test, check, notebooks. Each makes its environment once; later runs need no network.
# A changed pyproject.toml brings an environment up to date.

PYTHON ?= python3
OUT := out/tabletop

.PHONY: demo test check notebooks clean
.DELETE_ON_ERROR:

# The installed package is a copy, so the demo's environment depends on the sources as well.
SOURCES := $(shell find handeye_fg factors -type f -not -path '*/__pycache__/*')

demo: .env-demo/done .env-demo/package
	.env-demo/bin/handeye-fg calibrate data/tabletop/images data/tabletop/poses.csv \
		--camera data/tabletop/camera.yaml --output $(OUT)

# The build tool is kept in the environment: a rebuild of the package needs no network.
.env-demo/done: pyproject.toml
	$(PYTHON) -m venv .env-demo
	.env-demo/bin/python -m pip install --quiet --upgrade pip hatchling
	.env-demo/bin/python -m pip install --quiet .
	touch $@
	touch .env-demo/package

.env-demo/package: .env-demo/done $(SOURCES)
	.env-demo/bin/python -m pip install --quiet --no-deps --no-build-isolation --force-reinstall .
	touch $@

test: .env-test/done
	OMP_NUM_THREADS=1 .env-test/bin/python -m pytest -n auto --dist worksteal --cov --cov-report=term-missing:skip-covered

.env-test/done: pyproject.toml
	$(PYTHON) -m venv .env-test
	.env-test/bin/python -m pip install --quiet --upgrade pip
	.env-test/bin/python -m pip install --quiet --editable . --group dev
	touch $@

# In place, with all draws; cells that need data outside the repository say that they are left out.
notebooks: .env-test/done
	OMP_NUM_THREADS=1 .env-test/bin/jupyter execute --inplace notebooks/*.ipynb

check: .env-test/done .env-wheel/done
	.env-test/bin/ruff check
	.env-test/bin/ruff format --check
	.env-test/bin/mypy
	.env-test/bin/lint-imports
	rm -rf dist
	.env-wheel/bin/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist .
	.env-wheel/bin/python -m pip install --quiet --no-deps --no-index --force-reinstall dist/*.whl
	.env-wheel/bin/python -I -c "$$WHEEL_CHECK"

define WHEEL_CHECK
from importlib.metadata import files, packages_distributions
owners = packages_distributions()["factors"]
if owners != ["handeye-fg"]:
    raise SystemExit(f"the package factors belongs to {owners}, wanted handeye-fg alone")
wanted = {"handeye_fg/py.typed", "factors/py.typed", "handeye_fg/report/template.html", "handeye_fg/report/assets/style.css",
          "handeye_fg/io/result.schema.json"}
missing = wanted - {str(file) for file in files("handeye-fg")}
if missing:
    raise SystemExit(f"the wheel lacks {sorted(missing)}")
print("wheel: complete")
endef
export WHEEL_CHECK

# Only what builds a wheel: the wheel is looked at as installed, without the sources beside it.
.env-wheel/done: pyproject.toml
	$(PYTHON) -m venv .env-wheel
	.env-wheel/bin/python -m pip install --quiet --upgrade pip hatchling
	touch $@

clean:
	rm -rf .env-demo .env-test .env-wheel dist out
