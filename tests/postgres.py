"""A PostgreSQL server for tests: in a folder of its own, on 127.0.0.1, gone when the command ends.

    python3 tests/postgres.py -- cargo test --release --test it jobs_store

makes a cluster with the programs of Debian's `postgresql` package (or those on PATH, or in the folder named by
PG_BIN), starts it on a free port, runs the command with TEST_POSTGRES_URL set to its address and TEST_POSTGRES_ROOT to
the certificate by which it is known, stops the server, and ends with the command's status. Root runs the server as the
user `postgres`, since PostgreSQL refuses root.
"""

from __future__ import annotations

import argparse
import os
import pwd
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

VARIABLE, ROOT_VARIABLE = "TEST_POSTGRES_URL", "TEST_POSTGRES_ROOT"
# Nothing of a test outlives it, so nothing needs to be on the disk; many tests run at once.
FOR_TESTS = {"fsync": "off", "synchronous_commit": "off", "full_page_writes": "off", "max_connections": "400"}


# A certificate for 127.0.0.1 alone, signed by itself.
CERTIFICATE = """
[req]
prompt = no
distinguished_name = name
x509_extensions = extensions
[name]
CN = PostgreSQL for tests
[extensions]
basicConstraints = critical, CA:FALSE
subjectAltName = IP:127.0.0.1
"""


class Missing(Exception):
    """The programs are not there, or cannot run here."""


def programs() -> Path:
    """The folder of initdb and postgres."""
    named = [Path(os.environ["PG_BIN"])] if "PG_BIN" in os.environ else []
    found = shutil.which("initdb")
    on_path = [Path(found).parent] if found else []
    debian = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: -float(path.parent.name))
    for folder in [*named, *debian, *on_path]:
        if (folder / "initdb").exists() and (folder / "postgres").exists():
            return folder
    raise Missing(
        "PostgreSQL is missing, and the tests of the shared job store need it: `apt-get install postgresql`, or name the "
        "folder of initdb and postgres by PG_BIN"
    )


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Postgres:
    """A server on a cluster in `folder`; may be killed and started again."""

    def __init__(self, folder: str, settings: dict[str, str] | None = None):
        self.folder, self.settings, self.port = Path(folder), settings or {}, free_port()
        self.programs, self.process = programs(), None
        self.owner = {}
        if os.geteuid() == 0:
            try:
                user = pwd.getpwnam("postgres")
            except KeyError as error:
                raise Missing("PostgreSQL refuses root, and there is no user postgres to run it as") from error
            self.owner = {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
            os.chown(self.folder, user.pw_uid, user.pw_gid)
        self.run("initdb", "--pgdata", str(self.folder / "data"), "--auth", "trust", "--username", "rigsmith",
                 "--encoding", "UTF8", "--locale", "C", "--no-sync")  # fmt: skip

    def encrypt(self) -> Path:
        """Has connections encrypted that ask for it. Gives the certificate."""
        if not shutil.which("openssl"):
            raise Missing("openssl is missing, and makes the server's certificate: `apt-get install openssl`")
        (self.folder / "certificate.cnf").write_text(CERTIFICATE)
        files = {"ssl_key_file": str(self.folder / "key.pem"), "ssl_cert_file": str(self.folder / "certificate.pem")}
        subprocess.run(
            ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2",
             "-config", "certificate.cnf", "-keyout", files["ssl_key_file"], "-out", files["ssl_cert_file"]],
            cwd=self.folder, check=True, capture_output=True, **self.owner,
        )  # fmt: skip
        self.settings = {**self.settings, "ssl": "on", **files}
        return Path(files["ssl_cert_file"])

    def run(self, program: str, *arguments: str) -> str:
        done = subprocess.run(
            [self.programs / program, *arguments], cwd=self.folder, capture_output=True, text=True, **self.owner
        )
        if done.returncode:
            raise RuntimeError(f"{program}: {done.stderr or done.stdout}")
        return done.stdout

    @property
    def url(self) -> str:
        return f"postgres://rigsmith@127.0.0.1:{self.port}/postgres"

    def query(self, statement: str) -> str:
        """The answer of psql, one row a line, columns parted by |."""
        return self.run("psql", "--no-psqlrc", "-qAt", "-v", "ON_ERROR_STOP=1", "-c", statement, self.url).strip()

    def start(self) -> Postgres:
        settings = {"listen_addresses": "127.0.0.1", "port": str(self.port), "unix_socket_directories": "", **self.settings}
        options = [part for name, value in settings.items() for part in ("-c", f"{name}={value}")]
        with open(self.folder / "log", "ab") as log:
            self.process = subprocess.Popen(
                [self.programs / "postgres", "-D", str(self.folder / "data"), *options],
                cwd=self.folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True, **self.owner,
            )  # fmt: skip
        until = time.monotonic() + 60
        while time.monotonic() < until:
            if self.process.poll() is not None:
                break
            try:
                self.query("SELECT 1")
                return self
            except RuntimeError:
                time.sleep(0.05)
        raise RuntimeError(f"PostgreSQL did not start:\n{(self.folder / 'log').read_text()[-2000:]}")

    def stop(self, how: int = signal.SIGINT) -> None:
        """SIGINT closes connections and stops; SIGQUIT drops everything, as a crash does."""
        if self.process and self.process.poll() is None:
            self.process.send_signal(how)
            self.process.wait()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", nargs="+")
    command = parser.parse_args().command
    folder = tempfile.mkdtemp(prefix="rigsmith-postgres-")
    try:
        server = Postgres(folder, FOR_TESTS)
        try:
            certificate = server.encrypt()
            os.chmod(folder, 0o755)  # for whoever reads the certificate
            server.start()
            return subprocess.call(command, env={**os.environ, VARIABLE: server.url, ROOT_VARIABLE: str(certificate)})
        finally:
            server.stop(signal.SIGQUIT)
    except Missing as missing:
        print(f"error: {missing}", file=sys.stderr)
        return 1
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
