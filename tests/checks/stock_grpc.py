"""Asks the built service over gRPC as a stranger would: a stock client that knows nothing but reflection.

    python stock_grpc.py

Starts `target/release/rigsmith serve` on a folder of its own, runs the example of docs/grpc.md, and then asks for what only a
client of another make can show: both reflection services, health, error details, and a stream that is left early. Ends with
the summary that `make test` adds up.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

import grpc
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from grpc_reflection.v1alpha import reflection_pb2
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import ProtoReflectionDescriptorDatabase

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tests/reliability"))

from service import Service  # noqa: E402

SERVICES = {
    "rigsmith.v1.RigService", "google.longrunning.Operations", "grpc.health.v1.Health",
    "grpc.reflection.v1.ServerReflection", "grpc.reflection.v1alpha.ServerReflection",
}  # fmt: skip
STATUS_DETAILS = "grpc-status-details-bin"


class Client:
    """Any method of any service, by reflection."""

    def __init__(self, host: str):
        self.channel = grpc.insecure_channel(host)
        self.database = ProtoReflectionDescriptorDatabase(self.channel)
        self.pool = DescriptorPool(self.database)

    def message(self, name: str):
        return GetMessageClass(self.pool.FindMessageTypeByName(name))

    def call(self, service: str, method: str, /, **members):
        found = self.pool.FindServiceByName(service).methods_by_name[method]
        kind = self.channel.unary_stream if found.server_streaming else self.channel.unary_unary
        sent = GetMessageClass(found.input_type)(**members)
        answer = GetMessageClass(found.output_type).FromString
        return kind(f"/{service}/{method}", lambda message: message.SerializeToString(), answer)(sent, timeout=60)

    def rigs(self, method: str, /, **members):
        return self.call("rigsmith.v1.RigService", method, **members)

    def details(self, error: grpc.RpcError) -> dict:
        """The details of a refusal, by the name of their type."""
        told = dict(error.trailing_metadata())[STATUS_DETAILS]
        status = self.message("google.rpc.Status").FromString(told)
        assert status.code == error.code().value[0] and status.message == error.details()
        read = {}
        for any_ in status.details:
            name = any_.type_url.rpartition("/")[2]
            read[name.rpartition(".")[2]] = self.message(name).FromString(any_.value)
        return read


def the_example_of_the_documentation_works(host: str, folder: Path):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs/grpc.md").read_text(), re.DOTALL)
    assert len(blocks) == 1, "one example"
    ran = subprocess.run(
        [sys.executable, "-c", blocks[0]], cwd=folder, env={**os.environ, "HOST": host}, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    assert (folder / "rigged.glb").read_bytes()[:4] == b"glTF"
    assert "snapshot" in ran.stdout and ran.stdout.rstrip().endswith("done"), ran.stdout


def both_reflection_services_list_every_service(host: str, folder: Path):
    client = Client(host)
    assert set(client.database.get_services()) == SERVICES
    # The newer version has the same messages.
    path = "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo"
    request, response = reflection_pb2.ServerReflectionRequest, reflection_pb2.ServerReflectionResponse
    ask = client.channel.stream_stream(path, request.SerializeToString, response.FromString)
    answers = list(ask(iter([request(list_services="")])))
    assert {service.name for service in answers[0].list_services_response.service} == SERVICES


def health_is_serving(host: str, folder: Path):
    for service in ["", "rigsmith.v1.RigService"]:
        assert Client(host).call("grpc.health.v1.Health", "Check", service=service).status == 1, service


def refusals_have_details_that_a_program_can_read(host: str, folder: Path):
    client = Client(host)
    inline = {"inline": {"media_type": "model/obj", "data": b"v 0 0 0\n"}}
    try:
        client.rigs("CreateRig", mesh=inline, options={"detail": 2.0, "max_influences": 99})
        raise AssertionError("refused")
    except grpc.RpcError as error:
        assert error.code() is grpc.StatusCode.INVALID_ARGUMENT
        details = client.details(error)
    assert (details["ErrorInfo"].reason, details["ErrorInfo"].domain) == ("invalid_parameter", "rigsmith")
    assert [violation.field for violation in details["BadRequest"].field_violations] == ["detail", "max_influences"]


def a_job_that_fails_is_an_operation_that_failed(host: str, folder: Path):
    client = Client(host)
    operation = client.rigs("CreateRig", mesh={"inline": {"media_type": "model/obj", "data": b"v 0 0 0\n"}})
    operation = client.call("google.longrunning.Operations", "WaitOperation", name=operation.name)
    assert operation.done and operation.WhichOneof("result") == "error", operation
    (told,) = [any_ for any_ in operation.error.details if any_.type_url.endswith("ErrorInfo")]
    assert client.message("google.rpc.ErrorInfo").FromString(told.value).reason == "no_geometry"


def a_stream_that_is_left_early_leaves_the_job_alone(host: str, folder: Path):
    client = Client(host)
    mesh = {"inline": {"media_type": "model/gltf-binary", "data": (folder / "hero.glb").read_bytes()}}
    operation = client.rigs("CreateRig", mesh=mesh, no_cache=True, options={"seed": 3})
    rig = operation.name.removeprefix("operations/")
    events = client.rigs("WatchRig", id=rig)
    first = next(events)
    assert first.snapshot.id == rig
    events.cancel()
    # Where it was left, it is taken up again.
    rest = [event.sequence for event in client.rigs("WatchRig", id=rig, after_sequence=first.sequence)]
    assert rest == list(range(first.sequence + 1, first.sequence + 1 + len(rest))) and rest
    operation = client.call("google.longrunning.Operations", "GetOperation", name=operation.name)
    made = client.message("rigsmith.v1.Rig").FromString(operation.response.value)
    assert made.progress == 100 and made.result.report["skeleton"]["joints"] > 0


CHECKS = [
    the_example_of_the_documentation_works,
    both_reflection_services_list_every_service,
    health_is_serving,
    refusals_have_details_that_a_program_can_read,
    a_job_that_fails_is_an_operation_that_failed,
    a_stream_that_is_left_early_leaves_the_job_alone,
]


def main() -> int:
    failed = 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "hero.glb").write_bytes((ROOT / "tests/fixtures/sample-character.glb").read_bytes())
        service = Service(str(ROOT / "target/release/rigsmith"), str(folder / "data"), str(folder / "log")).start()
        try:
            for check in CHECKS:
                try:
                    check(f"127.0.0.1:{service.port}", folder)
                except Exception:
                    failed += 1
                    print(f"{check.__name__.replace('_', ' ')}: FAILED\n{traceback.format_exc()}")
        finally:
            service.stop()
    print(f"stock gRPC client: {len(CHECKS) - failed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
