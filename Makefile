# Two commands for a newcomer: `make demo` and `make test`. They write only to .venv/ and out/.

PYTHON ?= python3.11
VENV   ?= .venv
OUT    ?= out/demo
PIP_FLAGS ?=
WORKERS ?= 2
EXTRAS ?= factory,learn,dev

.PHONY: help demo demo-small weights test fuzz lint clean
help:
	@echo "make demo        install into $(VENV)/, render a small data set, compare the two renderers, edit a picture and a photograph; then open $(OUT)/index.html"
	@echo "make demo-small  the same with the smallest job, which has sixteen pictures"
	@echo "make weights     from nothing to the weights of the preset general-compact: never run to its end, about twelve hours of processor time by estimate"
	@echo "make test        install into $(VENV)/ and run the tests"
	@echo "make fuzz        feed damaged files and unusual options to every command for ten minutes"
	@echo "make lint        check the code's style and its types"
	@echo "make clean       delete $(VENV)/, out/ and build/"

# Install once, and again when the requirements change. The stamp file marks a complete installation; an interrupted one leaves only a folder.
$(VENV)/installed: pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) not found: Blender's wheel needs Python 3.11; install it, or give its path: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)"; exit 1; }
	@echo "Installing into $(VENV)/. The first time this downloads about 1 GB (Blender 370 MB, torch 200 MB) and takes two minutes more."
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install $(PIP_FLAGS) --constraint constraints.txt --editable ".[$(EXTRAS)]"
	@touch $@

# AGREE_FLAGS can limit the comparison, for example AGREE_FLAGS="--limit 20", because it takes longer than the rendering.
JOB         ?= demo
AGREE_FLAGS ?=

demo: $(VENV)/installed
	@echo "Rendering and comparing takes eight to fifteen minutes on two cores. If it is interrupted, the same command continues."
	$(VENV)/bin/python -m factory render $(JOB) --out $(OUT)/data --workers $(WORKERS)
	$(VENV)/bin/python -m factory verify $(OUT)/data
	$(VENV)/bin/python -m factory preview $(OUT)/data --out $(OUT)/preview --overwrite
	$(VENV)/bin/python -m learn agree $(OUT)/data --out $(OUT)/agreement $(AGREE_FLAGS)
	$(VENV)/bin/python -m learn predict $(OUT)/data --out $(OUT)/prediction --overwrite
	$(VENV)/bin/python -m learn predict $(OUT)/prediction/picture.png --mask $(OUT)/prediction/mask.png --out $(OUT)/photograph --overwrite
	$(VENV)/bin/python -m factory render --mesh chair:29 --material brass --material green-latex --material gray-plastic --light interior --views 3 --rotations 37 --size 128 --tier direct --out $(OUT)/held-out
	$(VENV)/bin/python -m learn edit $(OUT)/held-out --weights joint-compact --material green-latex gray-plastic --out $(OUT)/edit --overwrite
	$(VENV)/bin/python -m learn edit example:espresso-cup --material dark-blue-paint+keep gold-metallic-paint3+dark-blue-paint --out $(OUT)/cup --overwrite
	$(VENV)/bin/python -m learn.agreement.demo_page --title "brdfactory: $(JOB)" --sheet $(OUT)/preview/sheet.png --prediction $(OUT)/prediction/sheet.png --prediction $(OUT)/photograph/sheet.png --edit $(OUT)/edit/sheet.png --edit $(OUT)/cup/sheet.png --agreement $(OUT)/agreement --out $(OUT)/index.html
	@echo "Done: open $(OUT)/index.html"

demo-small:
	$(MAKE) --no-print-directory demo JOB=smallest WORKERS=1

# Each command continues what it has begun, so an interrupted run is continued by the same target.
WEIGHTS_OUT ?= out/weights
weights: $(VENV)/installed
	$(VENV)/bin/python -m factory render geometry-general --out $(WEIGHTS_OUT)/geometry --workers $(WORKERS)
	$(VENV)/bin/python -m factory lights make --count 1000 --library $(WEIGHTS_OUT)/lights --workers $(WORKERS)
	$(VENV)/bin/python -m learn train general-compact --data $(WEIGHTS_OUT)/geometry --lights $(WEIGHTS_OUT)/lights --workers 2 --out $(WEIGHTS_OUT)/run

test: $(VENV)/installed
	$(VENV)/bin/python -m pytest --numprocesses $(WORKERS) --dist worksteal $(PYTEST_FLAGS)

# Ten minutes by default. For longer: make fuzz FUZZ_FLAGS="--minutes 60 --seed 3".
FUZZ_FLAGS ?=
fuzz: $(VENV)/installed
	$(VENV)/bin/python -m tests.fuzz $(FUZZ_FLAGS)

lint: $(VENV)/installed
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/mypy

clean:
	rm -rf $(VENV) out build
