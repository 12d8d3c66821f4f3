"""The built service, once for all tests."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(PACKAGE / "src"), str(PACKAGE), str(ROOT / "tests/reliability")]

import generate  # noqa: E402
from service import Service  # noqa: E402

BINARY = ROOT / "target/release/rigsmith"
SAMPLE = ROOT / "tests/fixtures/sample-character.glb"

# Before any test imports the package.
generate.write(BINARY)


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    folder = tmp_path_factory.mktemp("service")
    running = Service(str(BINARY), str(folder / "data"), str(folder / "log")).start()
    yield running
    running.stop()


@pytest.fixture
def server(service: Service) -> str:
    return f"http://127.0.0.1:{service.port}"


@pytest.fixture
def knight(tmp_path: Path) -> Path:
    path = tmp_path / "knight.glb"
    path.write_bytes(SAMPLE.read_bytes())
    return path
