# Two commands for a newcomer: `make demo` and `make test`. Everything they make lies in .venv/ and out/.

PYTHON ?= python3.11
VENV   ?= .venv
OUT    ?= out/demo
PIP_FLAGS ?=
WORKERS ?= 2

.PHONY: help demo demo-small test lint clean
help:
	@echo "make demo    install into $(VENV)/, render a small data set, check that two renderers agree; then open $(OUT)/index.html"
	@echo "make test    install into $(VENV)/ and run the tests"
	@echo "make lint    check the code's style"
	@echo "make clean   delete $(VENV)/, out/ and build/"

# Installed once, again when the requirements change. A stamp tells, because an interrupted install leaves a folder behind.
$(VENV)/installed: pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) not found: Blender's wheel needs Python 3.11; install it or say where it is: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)"; exit 1; }
	@echo "Installing into $(VENV)/: about 1 GB of downloads the first time (Blender 370 MB, torch 200 MB), then two minutes."
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install $(PIP_FLAGS) --constraint constraints.txt --editable ".[factory,learn,dev]"
	@touch $@

demo: $(VENV)/installed
	@echo "The demo takes about DEMO_MINUTES minutes on two cores; stopped at any time, the same command continues."
	$(VENV)/bin/python -m factory render manifests/jobs/demo.json --out $(OUT)/data --workers $(WORKERS)
	$(VENV)/bin/python -m factory verify $(OUT)/data
	$(VENV)/bin/python -m learn agree $(OUT)/data --out $(OUT)/agreement
	$(VENV)/bin/python -m factory preview $(OUT)/data --out $(OUT)/preview
	$(VENV)/bin/python -m manifests.page $(OUT)
	@echo "Done: open $(OUT)/index.html"

test: $(VENV)/installed
	$(VENV)/bin/python -m pytest $(PYTEST_FLAGS)

lint: $(VENV)/installed
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check

clean:
	rm -rf $(VENV) out build
