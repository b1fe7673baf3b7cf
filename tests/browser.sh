#!/usr/bin/env bash
# The live page in a real browser: tests/browser.sh URG [PICTURES]
#
# Needs chromium, chromedriver and curl. URG is the program, built with feature
# web; into the folder PICTURES, if given, go screenshots to be looked at.
set -euo pipefail
urg=$1 pictures=${2:-}
work=$(mktemp -d)
declare -A process=()
finish() {
    [ -z "${session:-}" ] || curl -s -X DELETE "$session" >"$work/end" || true
    kill "${process[@]}" 2>"$work/end" || true
    wait
    rm -rf "$work"
}
trap finish EXIT

fail() {
    echo "browser: $*" >&2
    exit 1
}

# start NAME TEXT COMMAND...: runs it in the background until its output has TEXT.
start() {
    local name=$1 text=$2
    shift 2
    : >"$work/$name"
    "$@" >"$work/$name" 2>&1 &
    process[$name]=$!
    for _ in {1..200}; do
        if grep -q "$text" "$work/$name"; then return; fi
        sleep 0.1
    done
    cat "$work/$name"
    fail "$name does not start"
}

stop() {
    kill -s INT "${process[$1]}"
    wait "${process[$1]}" || fail "$1 ended with $?"
    unset "process[$1]"
}

sensor() { start sensor "on USB" "$urg" emulate --link "$work/urg"; }
server() { start server "live page" "$urg" serve "$work/urg" --listen "$1"; }

# post PATH JSON: asks the browser's driver.
post() { curl -sS --max-time 30 -H 'Content-Type: application/json' -d "$2" "$session$1"; }

# js SCRIPT: what the script gives in the page, as JSON.
js() {
    local answer
    answer=$(post /execute/sync "{\"script\": \"$1\", \"args\": []}")
    answer=${answer#'{"value":'}
    echo "${answer%\}}"
}

# becomes SCRIPT VALUE: waits until it does.
becomes() {
    local value
    for _ in {1..200}; do
        value=$(js "$1")
        if [ "$value" = "$2" ]; then return; fi
        sleep 0.1
    done
    fail "$1 is $value and not $2"
}

status() { becomes "return document.getElementById('status').textContent" "\"$1\""; }

picture() {
    [ -n "$pictures" ] || return 0
    curl -sS "$session/screenshot" | sed 's/^{"value":"//; s/"}$//' | base64 -d >"$pictures/$1.png"
}

size() { post /goog/cdp/execute "{\"cmd\": \"Emulation.setDeviceMetricsOverride\", \"params\":
    {\"width\": $1, \"height\": $2, \"deviceScaleFactor\": $3, \"mobile\": $4}}" >"$work/answer"; }

sensor
server 0
url=$(grep -o 'http://[0-9.:]*/' "$work/server")
start driver "successfully on port" chromedriver --port=0
driver=http://127.0.0.1:$(grep -o 'successfully on port [0-9]*' "$work/driver" | grep -o '[0-9]*$')
session=$driver/session/$(curl -sS -d "{\"capabilities\": {\"alwaysMatch\": {
    \"goog:loggingPrefs\": {\"browser\": \"ALL\"}, \"goog:chromeOptions\": {\"args\": [
    \"--headless\", \"--no-sandbox\", \"--disable-gpu\", \"--disable-quic\", \"--no-first-run\",
    \"--disable-background-networking\", \"--disable-component-update\", \"--disable-sync\",
    \"--user-data-dir=$work/profile\"]}}}}" "$driver/session" |
    tee "$work/answer" | grep -o '"sessionId":"[^"]*' | cut -d'"' -f4) || fail "$(cat "$work/answer")"

size 1280 800 1 false
post /url "{\"url\": \"$url\"}" >"$work/answer"
status Live
becomes "return parseFloat(document.getElementById('rate').textContent) > 5" true
js "window.before = document.getElementById('radar').toDataURL()" >"$work/answer"
becomes "return document.getElementById('radar').toDataURL() !== window.before" true
becomes "return performance.getEntriesByType('resource').every(e => e.name.startsWith('$url') || e.name.startsWith('data:'))" true
log=$(post /se/log '{"type": "browser"}')
[ "$log" = '{"value":[]}' ] || fail "the page complains: $log"
picture desktop

stop sensor
status "Sensor away"
picture away
sensor
status Live

stop server
status "Server away"
server "$(cut -d: -f3 <<<"$url" | tr -d /)"
status Live

size 390 844 2 true
becomes "return document.documentElement.scrollWidth" 390
picture phone
stop server
stop sensor
echo "browser: the page lives, says who is away, and comes back"
