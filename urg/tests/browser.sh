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

sensor() { start sensor "emulated sensor" "$urg" emulate --link "$work/urg"; }
server() { start server "live page" "$urg" serve "$work/urg" --listen "$1"; }
# served ARGUMENTS...: starts another server, and opens its page.
served() {
    start other "live page" "$urg" serve "$@" --listen 0
    open "$(grep -o 'http://[0-9.:]*/' "$work/other")"
}

# post PATH JSON: commands the browser's driver.
post() { curl -sS --max-time 30 -H 'Content-Type: application/json' -d "$2" "$session$1"; }

# js SCRIPT: runs the script in the page, and prints its result as JSON.
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

# element ID: the script that finds it.
element() { echo "document.getElementById('$1')"; }

# key KEY: presses it, wherever the focus is.
key() {
    post /actions "{\"actions\": [{\"type\": \"key\", \"id\": \"keys\", \"actions\": [
        {\"type\": \"keyDown\", \"value\": \"$1\"}, {\"type\": \"keyUp\", \"value\": \"$1\"}]}]}" >"$work/answer"
}

open() { post /url "{\"url\": \"$1\"}" >"$work/answer"; }

# quiet: fails if the page has logged anything.
quiet() {
    local log
    log=$(post /se/log '{"type": "browser"}')
    [ "$log" = '{"value":[]}' ] || fail "the page complains: $log"
}

theme() { post /goog/cdp/execute "{\"cmd\": \"Emulation.setEmulatedMedia\", \"params\":
    {\"features\": [{\"name\": \"prefers-color-scheme\", \"value\": \"$1\"}]}}" >"$work/answer"; }

status() { becomes "return document.getElementById('status').textContent" "\"$1\""; }

# zoomed: zooms far in beside the origin, and waits until a ring is labelled there. The labels of
# the nearest points are not centred.
zoomed() {
    local script="const canvas = $(element radar), { clientWidth: width, clientHeight: height } = canvas;"
    script+=" window.rings = 0; canvas.getContext('2d').fillText = function (text, x, y) {"
    script+=" if (text.endsWith(' m') && this.textAlign === 'center' && x > 0 && x < width && y > 0 && y < height) window.rings += 1; };"
    script+=" radar.zoom(20, width * 0.35, height * 0.35);"
    js "$script" >"$work/answer"
    becomes "return window.rings > 0" true
    js "delete $(element radar).getContext('2d').fillText; radar.fit();" >"$work/answer"
}

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
theme dark
open "$url"
status Live
becomes "return parseFloat(document.querySelector('[data-of=rate]').textContent) > 5" true
becomes "return /^[0-9.]+ ms/.test(document.querySelector('[data-of=jitter]').textContent)" true
js "window.before = $(element radar).toDataURL()" >"$work/answer"
becomes "return $(element radar).toDataURL() !== window.before" true
becomes "return performance.getEntriesByType('resource').every(e => e.name.startsWith('$url') || e.name.startsWith('data:'))" true
picture live-dark
# Keys work without a click.
key t
becomes "return $(element trail).getAttribute('aria-pressed')" '"true"'
key " "
status Paused
key " "
status Live
key "\\uE012"
becomes "return /step [0-9]+/.test($(element point).textContent)" true
quiet
theme light
picture live-light
zoomed

stop sensor
status "Sensor away"
becomes "return document.querySelectorAll('.stale').length" 1
becomes "return /as of/.test(document.querySelector('[data-of=since]').textContent)" true
becomes "return document.body.textContent.includes('urg list')" false
picture away
sensor
status Live
becomes "return document.querySelectorAll('.stale').length" 0

stop server
status "Server away"
becomes "return / since [0-9]/.test($(element banner).textContent)" true
becomes "return document.querySelectorAll('.stale').length" 1
picture server-away
for width in 390 320; do
    size "$width" 844 2 true
    becomes "return document.documentElement.scrollWidth" "$width"
    # The banner is above the radar and covers nothing.
    becomes "return $(element banner).getBoundingClientRect().bottom <= $(element radar).getBoundingClientRect().top" true
    picture "phone-$width-server-away"
done
server "$(cut -d: -f3 <<<"$url" | tr -d /)"
status Live
size 390 844 2 true
becomes "return document.documentElement.scrollWidth" 390
picture phone
stop server

# Two sensors, of which one goes away.
size 1280 800 1 false
theme dark
served "front=emulated@0.3,0,0" "rear=$work/urg@-0.3,0,180,upside-down"
status Live
# The left of a sensor that looks back is on the left, if it hangs upside down.
becomes "return radar.place(radar.layers[1], Math.PI / 2, 1)[0] < radar.place(radar.layers[1], 0, 0)[0]" true
becomes "return radar.place(radar.layers[0], Math.PI / 2, 1)[0] < radar.place(radar.layers[0], 0, 0)[0]" true
becomes "return [...document.querySelectorAll('[data-of=state]')].map(e => e.textContent).join()" '"Live,Live"'
picture two
zoomed
stop sensor
status "1 of 2 away"
becomes "return [...document.querySelectorAll('.card')].map(e => e.classList.contains('stale')).join()" '"false,true"'
picture two-one-away
size 320 640 2 true
becomes "return document.documentElement.scrollWidth" 320
picture two-narrow
stop other

# A UST, alone and beside a URG: each sector is as large as the room, and not as the sensor's range.
start ust "on Ethernet" "$urg" emulate --model ust-10lx --tcp 0
ust=$(grep -o 'tcp://[0-9.:]*' "$work/ust" | head -1)
size 1280 800 1 false
served "$ust"
status Live
becomes "return radar.layers[0].scan.values.length" 1081
becomes "return radar.layers[0].reach" 6
becomes "return radar.layers[0].geometry.max_distance" 30000
becomes "return $(element marks).textContent" '"02468 m"'
becomes "return radar.layers[0].codes[65533].kind" '"far"'
becomes "return $(element colours).textContent" '"Distance"'
picture ust
stop other
# Intensities are shades, and beside another sensor they are shades of the sensor's own colour.
served "$ust" --intensity
status Live
becomes "return $(element colours).textContent + $(element marks).textContent" '"Intensity642561024409616384"'
becomes "return [0, 127, 128, 8191, 8192, 262143].map(shade).join()" '"0,0,1,6,7,7"'
js "const context = $(element radar).getContext('2d'), fill = context.fill; window.fills = new Set();
    context.fill = function () { fills.add(this.fillStyle); fill.call(this); };" >"$work/answer"
becomes "return radar.shades.null.some(colour => fills.has(colour)) && !radar.palette.some(colour => fills.has(colour))" true
key "\\uE012"
becomes "return /intensity [0-9]+$/.test($(element point).textContent)" true
picture ust-intensities
stop other
served "ust=$ust@0,0.5,0" urg=emulated@0,-0.5,0 --intensity
status Live
becomes "return radar.layers.map(layer => layer.reach).join()" '"6,4.2"'
becomes "return $(element identity).textContent" '"ust: UST-10LX · urg: SOKUIKI Sensor URG-04LX"'
becomes "return radar.layers.map(layer => new Set(layer.scan.intensities?.map(shade)).size > 1).join()" '"true,false"'
picture ust-and-urg
stop other
stop ust

# Six sensors: no label covers another one, none is cut off, and the outermost ring has its own.
served front=emulated@0.3,0,0 rear=emulated@-0.3,0,180 left=emulated@0,1.2,90 right=emulated@0,-1.2,-90 \
    mast=emulated@0.1,0.1,45 gripper=emulated@-0.1,-0.1,-135
status Live
for width in 1600 390; do
    size "$width" 900 2 "$([ "$width" = 390 ] && echo true || echo false)"
    js "const context = $(element radar).getContext('2d'); window.boxes = []; const draw = Radar.prototype.draw;
        radar.draw = function () { window.boxes = []; draw.call(this); }; context.fillText = function (text, x, y) {
        const wide = this.measureText(text).width; const left = x - { left: 0, center: wide / 2, right: wide }[this.textAlign];
        window.boxes.push({ text, left, right: left + wide, top: y - 6, bottom: y + 6 }); };" >"$work/answer"
    outermost=$([ "$width" = 390 ] && echo "4 m" || echo "5 m")
    becomes "return ['front', 'rear', 'left', 'right', 'mast', 'gripper', '$outermost'].every(text => boxes.some(box => box.text === text))" true
    becomes "return boxes.filter((a, n) => boxes.slice(n + 1).some(b => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom)).length" 0
    becomes "return boxes.filter(b => b.left < 0 || b.top < 0 || b.right > radar.canvas.clientWidth || b.bottom > radar.canvas.clientHeight).length" 0
    js "delete radar.draw; delete $(element radar).getContext('2d').fillText" >"$work/answer"
    picture "six-$width"
done
stop other

# A recording.
if "$urg" record emulated "$work/run.mcap" --duration 3s 2>"$work/record"; then
    size 1280 800 1 false
    served "$work/run.mcap"
    status "At the end"
    picture recording
    key ","
    status Paused
    clock=$(js "return $(element clock).textContent")
    key ","
    becomes "return $(element clock).textContent !== ${clock//\"/\'}" true
    js "$(element seek).value = 0; $(element seek).oninput()" >"$work/answer"
    becomes "return $(element clock).textContent.startsWith('0:00.0')" true
    key o
    becomes "return $(element loop).getAttribute('aria-pressed')" '"true"'
    key " "
    status Playing
    for width in 390 320 768 844; do
        size "$width" 844 2 true
        becomes "return document.documentElement.scrollWidth" "$width"
        becomes "return ['back', 'on'].every(id => document.getElementById(id).offsetTop === $(element play).offsetTop)" true
        becomes "return $(element deck).scrollWidth <= $(element deck).clientWidth" true
        picture "recording-$width"
    done
    stop other
    # More scans than a playback keeps, so that it reads the file again and again.
    start fast "emulated sensor" "$urg" emulate --revolution 10ms --link "$work/quick"
    "$urg" record "$work/quick" "$work/long.mcap" --rate max --count 600 2>"$work/record"
    stop fast
    served "dead=$work/long.mcap" live=emulated --loop --speed 100
    states="return [...document.querySelectorAll('[data-of=state]')].map(e => e.textContent).join()"
    becomes "$states" '"Playing,Live"'
    echo overwritten >"$work/long.mcap"
    becomes "$states" '"Playback failed,Live"'
    picture playback-failed
    stop other
else
    grep -q 'feature `mcap`' "$work/record" || fail "$(cat "$work/record")"
    echo "skipped: recordings, which this urg lacks"
fi
echo "browser: the page shows live scans, reports what is away, recovers, and plays recordings"
