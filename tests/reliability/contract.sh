#!/bin/sh
# Generated requests against the OpenAPI document, by schemathesis: no 5xx, and no answer that the document does not
# describe. Needs `pip install schemathesis` (the program named by SCHEMATHESIS), and the built program.
#
#     tests/reliability/contract.sh [CASES_PER_OPERATION]        # 1000 makes more than 20,000 cases in all
set -eu
cd "$(dirname "$0")/../.."
CASES=${1:-100}
SCHEMATHESIS=${SCHEMATHESIS:-schemathesis}
BINARY=${BINARY:-target/release/rigsmith}
FOLDER=$(mktemp -d)
"$BINARY" serve --listen 127.0.0.1:0 --data "$FOLDER/data" >"$FOLDER/address" 2>"$FOLDER/log" &
SERVICE=$!
trap 'kill $SERVICE 2>/dev/null || true; wait $SERVICE 2>/dev/null || true; rm -rf "$FOLDER"' EXIT
HOST=
for _ in $(seq 300); do
    HOST=$(sed -n 's/.*listens on \(http:[^ ]*\).*/\1/p' "$FOLDER/address")
    [ -n "$HOST" ] && break
    sleep 0.1
done
[ -n "$HOST" ] || { echo "the service did not start:"; cat "$FOLDER/log"; exit 1; }
SCHEMATHESIS_HOOKS=tests/reliability/contract_hooks.py "$SCHEMATHESIS" run "$HOST/v1/openapi.json" --phases examples,coverage,fuzzing --max-examples "$CASES" --seed 1 \
    --checks not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance \
    --suppress-health-check all --continue-on-failure --request-timeout 90 --no-color
kill -0 $SERVICE || { echo "the service is gone"; exit 1; }
