"""What schemathesis must be told to send the examples of the OpenAPI document: how a body of JSON lines is written."""

import json

import schemathesis


@schemathesis.serializer("application/jsonl")
def json_lines(context, value) -> bytes:
    if isinstance(value, str):
        return value.encode()
    return b"".join(json.dumps(line).encode() + b"\n" for line in (value if isinstance(value, list) else [value]))
