# `make` lists what there is to do. Everything is built by cargo; this file only names the ways in.

LISTEN   ?= 127.0.0.1:8080
MINUTES  ?= 10
DATA     ?=
WHEEL    ?=
CARGO    ?= cargo
PYTHON   ?= python3
VENV     := models/.venv
CHECKS   := tests/checks
OUTPUTS  := target/checks/outputs
BINARY   := target/release/rigsmith

.DEFAULT_GOAL := help
.PHONY: help
help: ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sort -s -k1,1 | awk -F ':.*## ' '{ printf "  make %-15s %s\n", $$1, $$2 }'

# ---- use ------------------------------------------------------------------------------------------------------------

.PHONY: run
run: build ## fetch ONNX Runtime, build, and start the service on http://127.0.0.1:8080
	@printf '\nThe service starts on http://$(LISTEN). In another terminal, from this folder:\n\n'
	@printf '  curl -sS --fail-with-body -o rigged.glb -H "Content-Type: model/gltf-binary" -H "Prefer: wait=60" \\\n'
	@printf '       -H "Accept: model/gltf-binary" --data-binary @tests/fixtures/sample-character.glb \\\n'
	@printf '       http://$(LISTEN)/v1/rigs\n\n'
	@printf 'The API is described at http://$(LISTEN)/docs and, as OpenAPI, at http://$(LISTEN)/v1/openapi.json. Stop with Ctrl-C.\n\n'
	@exec $(BINARY) serve --listen $(LISTEN)

# The examples are there because they and the tests ask for more features of shared dependencies (regex-automata, zerocopy) than the
# program alone does: without them, cargo would compile it once for use and once more for the tests.
.PHONY: build
build: ort ## build the program (target/release/rigsmith) and the examples
	$(CARGO) build --release --locked --bins --examples

.PHONY: ort
ort: ## put ONNX Runtime into third_party/ (fetched once, pinned by digest; WHEEL=file uses a local copy)
	@$(PYTHON) tools/fetch_onnxruntime.py $(if $(WHEEL),--wheel $(WHEEL))

.PHONY: python-client
python-client: build python-packages ## make the Python package of the service's clients (clients/python) into target/python-client
	$(VENV)/bin/python clients/python/generate.py $(BINARY)
	$(VENV)/bin/python -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir target/python-client clients/python

# ---- check ----------------------------------------------------------------------------------------------------------

.PHONY: test
test: ort python-packages node-packages browser ## all that CI runs: lints, all tests, and the produced files in other people's programs
	@$(PYTHON) tests/suite.py

.PHONY: check
check: ## only the quick part: formatting and lints
	$(CARGO) fmt --check
	$(CARGO) clippy --release --all-targets --locked -- -D warnings

.PHONY: outputs
outputs: build python-packages ## rig every case of the checks into target/checks/outputs
	$(VENV)/bin/python $(CHECKS)/rig_cases.py $(OUTPUTS)

.PHONY: contact-sheet
contact-sheet: build python-packages ## draw the produced rigs on one sheet, target/checks/contact-sheet.png
	$(VENV)/bin/python $(CHECKS)/rig_cases.py --previews $(OUTPUTS)
	$(VENV)/bin/python $(CHECKS)/contact_sheet.py $(OUTPUTS) target/checks/contact-sheet.png

.PHONY: check-blender
check-blender: build python-packages ## load and pose the produced files in Blender (fetches about 1 GB; needs Python 3.11)
	$(VENV)/bin/python $(CHECKS)/rig_cases.py $(OUTPUTS)
	@$(CHECKS)/blender-venv.sh target/checks/blender-venv
	target/checks/blender-venv/bin/python $(CHECKS)/blender.py $(OUTPUTS)

.PHONY: fuzz
fuzz: ## every decoder under the fuzzer for MINUTES each (needs cargo-fuzz)
	@$(CARGO) fuzz --version >/dev/null 2>&1 || { echo 'cargo-fuzz is missing: `cargo install cargo-fuzz`'; exit 1; }
	@for target in $$($(CARGO) fuzz list); do \
		echo "== $$target"; $(CARGO) fuzz run $$target -- -max_total_time=$$(($(MINUTES) * 60)) || exit 1; done

.PHONY: bench
bench: ort ## time and memory per stage, beside this machine's matrix-product rate
	$(CARGO) bench --locked --bench pipeline --bench hollow_distance
	$(CARGO) bench --locked --bench geometry --bench rig

# ---- networks (models/TRAINING.md; these need PyTorch) ------------------------------------------------------------------

.PHONY: train
train: ## train the networks for MINUTES on DATA (cache files)
	@test -n "$(DATA)" || { echo 'name the training data: make train MINUTES=90 DATA="cache/*.npz" (models/TRAINING.md)'; exit 1; }
	PYTHON=$(PYTHON) models/train_all.sh --minutes $(MINUTES) $(DATA)

.PHONY: export
export: ## write the trained networks as ONNX graphs with their manifest
	$(PYTHON) models/export.py

.PHONY: evaluate
evaluate: build python-packages ## measure the built program on rigs that it never saw (DATA=folder or SET=file; PUBLISH=1 writes docs/models.md)
	$(VENV)/bin/python models/evaluate_rigs.py $(if $(DATA),--data $(DATA)) $(foreach file,$(SET),--set $(file)) $(if $(PUBLISH),--publish)

# ---- what the checks stand on -----------------------------------------------------------------------------------------

.PHONY: python-packages
python-packages: $(VENV)/.installed

$(VENV)/.installed: models/requirements.txt $(CHECKS)/requirements.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo 'Python 3.11 or newer is needed for the tests (PYTHON=path/to/python3 names another one)'; exit 1; }
	@$(PYTHON) -m venv $(VENV) \
		|| { echo 'python3 -m venv does not work here: `apt-get install python3-venv`'; exit 1; }
	@$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check $(foreach file,$^,-r $(file))
	@touch $@

.PHONY: node-packages
node-packages: $(CHECKS)/node_modules/.package-lock.json

$(CHECKS)/node_modules/.package-lock.json: $(CHECKS)/package-lock.json
	@command -v npm >/dev/null || { echo 'npm is missing: Node.js 18 or newer with npm is needed (`apt-get install nodejs npm`)'; exit 1; }
	@cd $(CHECKS) && npm ci --silent
	@touch $@

.PHONY: browser
browser:
	@$(CHECKS)/find-browser.sh >/dev/null

.PHONY: clean
clean: ## remove what was built and fetched
	rm -rf target third_party/onnxruntime $(VENV) $(CHECKS)/node_modules
