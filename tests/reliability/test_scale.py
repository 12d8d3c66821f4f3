"""The simulation of scale.py, where its answer is known, and the deployment files."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

sys.path.insert(0, str(Path(__file__).parent))
from scale import Mesh, Plan, simulate  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent.parent
SMALL = Plan(workers=20, uploads_per_minute=300, seconds=60, slowdown=1)
SECOND = (Mesh(1.0, 1.0, 1000, 1000),)


def test_the_same_seed_gives_the_same_answer():
    assert simulate(SMALL) == simulate(SMALL)
    assert simulate(SMALL) != simulate(replace(SMALL, seed=2))


def test_every_upload_becomes_one_finished_job_and_workers_are_as_busy_as_arithmetic_says():
    result = simulate(SMALL, SECOND)
    assert result["jobs"] == pytest.approx(300, rel=0.25)
    busy_s = 1 + 4 * SMALL.storage_ms / 1000
    assert result["load"]["workers"] == pytest.approx(result["jobs"] * busy_s / (20 * 60), rel=0.01)
    assert result["wait_s"]["p50"] < SMALL.gather_s + SMALL.rest_s


def test_too_few_workers_let_the_queue_grow_and_are_named():
    result = simulate(replace(SMALL, workers=3), SECOND)
    assert result["used_up_first"] == "workers"
    assert result["wait_s"]["max"] > 10 and result["waiting_max"] > 30


def test_a_slow_database_is_named():
    result = simulate(replace(SMALL, database_cores=1, submit_ms=150.0), SECOND)
    assert result["used_up_first"] == "database cores"
    assert result["database_wait_ms"] > 5


@pytest.mark.parametrize("name", ["compose.yaml", "kubernetes.yaml"])
def test_deployment_files_are_whole(name):
    documents = list(yaml.safe_load_all((ROOT / "deploy" / name).read_text()))
    settings = (ROOT / "src/config.rs").read_text() + (ROOT / "src/config/node.rs").read_text()
    used = {word for word in str(documents).replace("'", " ").split() if word.startswith("RIGSMITH_")}
    used = {word.rstrip(":,") for word in used} - {"RIGSMITH_MODELS"}
    assert used and all(f'"{name}"' in settings or name == "RIGSMITH_THREADS" for name in used), used
