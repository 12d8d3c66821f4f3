"""Writes the generated part of the package `rigsmith` from the OpenAPI document of the built program.

    python generate.py target/release/rigsmith

`rigsmith/api` is made by openapi-python-client: a type for each schema, a function for each operation. `rigsmith/options.py`
holds the options of a rig as keyword arguments, which that generator does not write. Neither is kept under version control.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parent / "src/rigsmith"
# A raw body is sent as application/octet-stream: what it is, its first bytes say. The generator leaves the other types out, and
# the lines of a batch's results, which it cannot read.
LEFT_OUT = re.compile(r"Unsupported content type |Cannot parse response .*\(Unsupported content_type application/jsonl\)")
COMPLAINTS = ("WARNING", "ERROR", "Unable", "Unsupported", "Cannot")
# The options of a request that is not about an asset alone.
REQUEST, NO_OPTION = "CreateRig", "asset"

Schema = dict[str, Any]


class BadDocument(Exception):
    """No client can be made of the document, or not all of one."""


def document_of(binary: Path) -> Schema:
    """The OpenAPI document of the program."""
    printed = subprocess.run([binary, "openapi"], capture_output=True, text=True, check=True)
    document: Schema = json.loads(printed.stdout)
    return document


def write_api(document: Schema, package: Path) -> None:
    """Writes the types and calls as the package `package`. Raises BadDocument for whatever the generator leaves out."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "openapi.json").write_text(json.dumps(document))
        (folder / "config.yaml").write_text("post_hooks: []\n")
        command = [sys.executable, "-m", "openapi_python_client", "generate", "--meta", "none", "--overwrite"]
        command += ["--config", "config.yaml", "--path", "openapi.json", "--output-path", str(package)]
        made = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    said = made.stdout + made.stderr
    complaints = [line for line in said.splitlines() if line.startswith(COMPLAINTS)]
    faults = [line for line in complaints if not (LEFT_OUT.match(line) or line.startswith("WARNING parsing"))]
    told = sum(bool(LEFT_OUT.match(line)) for line in complaints)
    if made.returncode != 0 or faults or sum(line.startswith("WARNING parsing") for line in complaints) != told:
        raise BadDocument(f"the client could not be made well:\n{said}")


def write_options(document: Schema, file: Path) -> None:
    """Writes the members of a request for a rig as a TypedDict."""
    schemas = document["components"]["schemas"]
    lines = ['"""Options of a rig. Written by generate.py from the OpenAPI document."""', ""]
    lines += ["from __future__ import annotations", "", "from typing import Any, Literal, TypedDict", "", ""]
    lines += ["class Options(TypedDict, total=False):", '    """Keyword arguments of whatever makes a rig or checks a mesh."""']
    for name, schema in members(schemas[REQUEST], schemas):
        if name != NO_OPTION:
            lines += ["", f"    {name}: {annotation(schema, schemas)}"]
            lines += [f"    {json.dumps(described(schema), ensure_ascii=False)}"]
    file.write_text("\n".join(lines) + "\n")


def resolved(schema: Schema, schemas: Schema) -> Schema:
    """`schema`, or what it refers to."""
    reference = schema.get("$ref")
    found: Schema = schemas[reference.rpartition("/")[2]] if reference else schema
    return found


def members(schema: Schema, schemas: Schema) -> list[tuple[str, Schema]]:
    """The properties of an object, those of its parts included."""
    own = list(schema.get("properties", {}).items())
    return own + [member for part in schema.get("allOf", []) for member in members(resolved(part, schemas), schemas)]


def described(schema: Schema) -> str:
    """What the document says of a member, in one line."""
    return " ".join(str(schema.get("description", "")).split())


def annotation(schema: Schema, schemas: Schema) -> str:
    """The type of a value in Python."""
    schema = resolved(schema, schemas)
    several = schema.get("oneOf") or schema.get("anyOf") or schema.get("allOf")
    if several:
        return " | ".join(dict.fromkeys(annotation(kind, schemas) for kind in several))
    if "enum" in schema:
        return f"Literal[{', '.join(json.dumps(word) for word in schema['enum'])}]"
    kinds = schema.get("type", [])
    return " | ".join(dict.fromkeys(simple(kind, schema, schemas) for kind in ([kinds] if isinstance(kinds, str) else kinds)))


def simple(kind: str, schema: Schema, schemas: Schema) -> str:
    """The type of a value of one JSON type."""
    match kind:
        case "array":
            return f"list[{annotation(schema['items'], schemas)}]"
        case "object":
            values = schema.get("additionalProperties")
            return f"dict[str, {annotation(values, schemas) if isinstance(values, dict) else 'Any'}]"
        case _:
            return {"string": "str", "number": "float", "integer": "int", "boolean": "bool", "null": "None"}[kind]


def write(binary: Path) -> None:
    """Writes all that is generated. Raises BadDocument."""
    document = document_of(binary)
    write_api(document, PACKAGE / "api")
    write_options(document, PACKAGE / "options.py")


def main() -> int:
    parser = argparse.ArgumentParser(description="Write the generated part of the package rigsmith.")
    parser.add_argument("binary", type=Path, help="the built program")
    try:
        write(parser.parse_args().binary.resolve())
    except BadDocument as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
