#!/usr/bin/env bash
# Reads what `urg publish --engine foxglove` serves with the client and the decoder of
# Foxglove's own packages: tests/publish/foxglove.sh PROGRAM (built with feature foxglove).
# Needs Node.js and npm; the packages go into a folder that is removed.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
program=$(realpath "$1")
for tool in node npm; do
    command -v "$tool" >/dev/null || { echo "skipped: $tool"; exit 0; }
done
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
echo '{"type": "module"}' >package.json
npm install --silent --no-audit --no-fund @foxglove/ws-protocol@0.8.0 @foxglove/rosmsg@5.0.5 \
    @foxglove/rosmsg2-serialization@3.1.0 ws@8.23.0 >npm.log 2>&1 ||
    { tail -n 3 npm.log; echo "skipped: npm cannot install the readers"; exit 0; }
cp "$here/foxglove.mjs" .
timeout 120 node foxglove.mjs "$program"
