"""Receives the webhooks of the built service as a stranger would: with the public library of Standard Webhooks.

    python webhooks.py

Starts `target/release/rigsmith serve` on a folder of its own, and receivers that take, fail, are slow, are gone, and replay. The
receiver that takes is the example of docs/webhooks.md. The long waits of the schedule are tried with a clock that can be set, in
`tests/it/jobs_store/webhooks.rs` and `tests/it/http/webhooks.rs`. Ends with the summary that `make test` adds up.
"""

from __future__ import annotations

import json
import re
import sys
import tempfile
import threading
import time
import traceback
import urllib.request
from dataclasses import dataclass, field
from datetime import datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from unittest import mock

import standardwebhooks.webhooks as library
from standardwebhooks import Webhook, WebhookVerificationError

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tests/reliability"))

from service import Service, free_port  # noqa: E402

SAMPLE = (ROOT / "tests/fixtures/sample-character.glb").read_bytes()
ENDED = ["rig.succeeded", "rig.failed", "rig.canceled"]
JSON = {"Content-Type": "application/json"}


@dataclass
class Received:
    at: float
    headers: dict[str, str]
    body: bytes

    @property
    def message(self) -> dict:
        return json.loads(self.body)


@dataclass
class Hook:
    """One path of the receiver: what came, and what is answered to it."""

    answer: callable
    received: list[Received] = field(default_factory=list)

    def has(self, count: int, wait_s: float = 60) -> list[Received]:
        until = time.monotonic() + wait_s
        while len(self.received) < count and time.monotonic() < until:
            time.sleep(0.02)
        assert len(self.received) == count, [received.message["type"] for received in self.received]
        return self.received


class Receiver(BaseHTTPRequestHandler):
    hooks: dict[str, Hook] = {}

    def do_POST(self):
        headers = {name.lower(): value for name, value in self.headers.items()}
        received = Received(time.monotonic(), headers, self.rfile.read(int(headers["content-length"])))
        hook = self.hooks[self.path]
        hook.received.append(received)
        status, further = hook.answer(received, len(hook.received))
        try:
            self.send_response(status)
            for name, value in {"Content-Length": "0", **further}.items():
                self.send_header(name, value)
            self.end_headers()
        except OSError:
            pass  # it waited no longer

    def log_message(self, *_):
        pass


class Claims:
    """Each method is one claim."""

    def __init__(self, service: Service, port: int, metrics_port: int) -> None:
        self.service, self.port, self.metrics_port = service, port, metrics_port

    def ask(self, method: str, path: str, body: dict | None = None) -> dict:
        status, _, answer = self.service.request(method, path, json.dumps(body) if body is not None else None, JSON)
        assert status < 300, (status, answer)
        return json.loads(answer or b"{}")

    def endpoint(self, answer, events=tuple(ENDED)) -> tuple[dict, Hook]:
        """An endpoint with a hook of its own."""
        hook = Hook(answer)
        path = f"/{len(Receiver.hooks)}"
        Receiver.hooks[path] = hook
        wanted = {"url": f"http://127.0.0.1:{self.port}{path}", "events": list(events)}
        return self.ask("POST", "/v1/webhook-endpoints", wanted), hook

    def rig(self) -> dict:
        """A rig that succeeds: the first time by work, later by the earlier result."""
        status, _, answer = self.service.rig(SAMPLE, name="hero.glb")
        assert status in (200, 202), answer
        return self.service.until_over(json.loads(answer)["links"]["self"], 120)[0]

    def newest(self, endpoint: dict, attempts: int, wait_s: float = 60) -> dict:
        """The newest delivery, once it was tried so often."""
        until = time.monotonic() + wait_s
        while time.monotonic() < until:
            deliveries = self.ask("GET", endpoint["links"]["deliveries"])["data"]
            if deliveries and len(deliveries[0]["attempts"]) >= attempts:
                return deliveries[0]
            time.sleep(0.05)
        raise AssertionError(deliveries)

    def done(self, endpoint: dict) -> None:
        self.ask("DELETE", endpoint["links"]["self"])

    def the_example_of_the_documentation_takes_each_message_once(self) -> None:
        blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs/webhooks.md").read_text(), re.DOTALL)
        assert len(blocks) == 1, "one example"
        printed = []
        example = {"print": lambda *words: printed.append(words)}
        exec(compile(blocks[0], "docs/webhooks.md", "exec"), example)
        secret = []
        endpoint, hook = self.endpoint(
            lambda received, _: (example["receive"](secret[0], received.headers, received.body), {}),
            ["rig.started", *ENDED],
        )
        secret.append(endpoint["secret"])
        rig = self.rig()
        types = sorted(received.message["type"] for received in hook.has(2))
        assert types == ["rig.started", "rig.succeeded"], types
        (told,) = [received.message for received in hook.received if received.message["type"] == "rig.succeeded"]
        assert told["data"] == self.service.json(rig["links"]["self"]), told
        files = [("fetch", artifact["url"]) for artifact in rig["result"]["artifacts"]]
        assert printed == files, printed
        self.ask("POST", self.newest(endpoint, 1)["links"]["redeliver"])
        hook.has(3)
        delivery = self.newest(endpoint, 2)
        assert [attempt["status"] for attempt in delivery["attempts"]] == [200, 200], delivery
        assert printed == files, "it did nothing the second time"
        self.done(endpoint)

    def a_receiver_that_fails_gets_the_message_again(self) -> None:
        endpoint, hook = self.endpoint(lambda _, count: (500 if count == 1 else 204, {}))
        self.rig()
        first, second = hook.has(2)
        waited = second.at - first.at
        assert 5 <= waited < 8, waited
        assert first.headers["webhook-id"] == second.headers["webhook-id"] and first.body == second.body
        assert int(second.headers["webhook-timestamp"]) > int(first.headers["webhook-timestamp"])
        for received in (first, second):
            Webhook(endpoint["secret"]).verify(received.body, received.headers)
        delivery = self.newest(endpoint, 2)
        assert delivery["state"] == "delivered" and delivery["next_attempt_at"] is None, delivery
        assert [attempt["status"] for attempt in delivery["attempts"]] == [500, 204], delivery
        self.done(endpoint)

    def a_receiver_that_wants_rest_gets_it(self) -> None:
        endpoint, hook = self.endpoint(lambda _, count: (503, {"Retry-After": "7200"}))
        self.rig()
        hook.has(1)
        delivery = self.newest(endpoint, 1)
        due, tried = (datetime.fromisoformat(text) for text in (delivery["next_attempt_at"], delivery["attempts"][0]["at"]))
        assert 7200 <= (due - tried).total_seconds() < 7260, delivery
        self.ask("POST", f"{endpoint['links']['self']}:test")
        time.sleep(2)
        hook.has(1)
        self.done(endpoint)

    def a_receiver_that_is_slow_holds_up_nobody_and_is_given_up_after_15_seconds(self) -> None:
        slow, _ = self.endpoint(lambda _, count: time.sleep(17) or (200, {}))
        quick, hook = self.endpoint(lambda *_: (200, {}))
        began = time.monotonic()
        self.rig()
        hook.has(1)
        assert time.monotonic() - began < 5
        delivery = self.newest(slow, 1)
        (attempt,) = delivery["attempts"]
        assert attempt["status"] is None and "15 s" in attempt["error"], attempt
        assert 15_000 <= attempt["duration_ms"] < 17_000 and delivery["state"] == "pending", delivery
        self.done(slow)
        self.done(quick)

    def a_receiver_that_is_gone_is_disabled(self) -> None:
        endpoint, hook = self.endpoint(lambda *_: (410, {}))
        self.rig()
        assert self.newest(endpoint, 1)["state"] == "failed"
        seen = self.ask("GET", endpoint["links"]["self"])
        assert not seen["enabled"] and "410" in seen["disabled_reason"], seen
        self.rig()
        time.sleep(2)
        hook.has(1)
        self.done(endpoint)

    def a_message_that_is_replayed_or_changed_is_refused(self) -> None:
        endpoint, hook = self.endpoint(lambda *_: (200, {}))
        self.ask("POST", f"{endpoint['links']['self']}:test")
        (caught,) = hook.has(1)
        webhook = Webhook(endpoint["secret"])
        webhook.verify(caught.body, caught.headers)
        later = str(int(caught.headers["webhook-timestamp"]) + 1)
        for changed in (
            (caught.body.replace(b"whe_", b"whf_"), caught.headers),
            (caught.body, {**caught.headers, "webhook-id": "evt_other"}),
            (caught.body, {**caught.headers, "webhook-timestamp": later}),
        ):
            self.refused(webhook, *changed)

        class Later(datetime):
            @classmethod
            def now(cls, tz=None):
                return cls.fromtimestamp(time.time() + 400, tz)

        with mock.patch.object(library, "datetime", Later):
            self.refused(webhook, caught.body, caught.headers)
        self.done(endpoint)

    def refused(self, webhook: Webhook, body: bytes, headers: dict[str, str]) -> None:
        try:
            webhook.verify(body, headers)
        except WebhookVerificationError:
            return
        raise AssertionError(f"taken: {headers}")

    def both_secrets_fit_while_one_is_replaced(self) -> None:
        endpoint, hook = self.endpoint(lambda *_: (200, {}))
        rotated = self.ask("POST", f"{endpoint['links']['self']}:rotate-secret")
        self.ask("POST", f"{endpoint['links']['self']}:test")
        (received,) = hook.has(1)
        for secret in (endpoint["secret"], rotated["secret"]):
            assert Webhook(secret).verify(received.body, received.headers)["type"] == "webhook.test"
        self.done(endpoint)

    def an_operator_sees_what_becomes_of_them(self) -> None:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.metrics_port}/metrics", timeout=30) as answer:
            told = answer.read().decode()
        for outcome in ("delivered", "retried", "gone"):
            assert re.search(rf'rigsmith_webhook_attempts_total{{outcome="{outcome}"}} [1-9]', told), told

    def what_was_not_taken_before_a_kill_comes_afterwards(self) -> None:
        endpoint, hook = self.endpoint(lambda _, count: (500 if count == 1 else 204, {}))
        rig = self.rig()
        hook.has(1)
        self.service.kill()
        self.service.start()
        _, second = hook.has(2)
        assert second.message["data"]["id"] == rig["id"]
        Webhook(endpoint["secret"]).verify(second.body, second.headers)
        self.done(endpoint)


def main() -> int:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Receiver)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    passed = failed = 0
    with tempfile.TemporaryDirectory() as place:
        metrics_port = free_port()
        arguments = ["--outgoing", "--outgoing-hosts", "127.0.0.1", "--metrics-listen", f"127.0.0.1:{metrics_port}"]
        binary = str(ROOT / "target/release/rigsmith")
        service = Service(binary, f"{place}/data", f"{place}/log", arguments).start()
        try:
            claims = Claims(service, server.server_port, metrics_port)
            for claim in [name for name in vars(Claims) if name.count("_") > 2 and not name.startswith("_")]:
                try:
                    getattr(claims, claim)()
                    passed += 1
                except Exception:  # whatever it is, the other claims are tried
                    failed += 1
                    print(f"FAILED: {claim.replace('_', ' ')}\n{traceback.format_exc()}")
        finally:
            service.stop()
    print(f"webhooks: {passed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
