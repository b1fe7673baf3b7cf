#!/usr/bin/env bash
# eclipse-cyclonedds-sys 0.0.4 (crates.io), the Rust bindings of Cyclone DDS, is built twice: cargo builds it once more if
# nothing has changed.
#
# A second `cargo build` of an unchanged package should build nothing. Expected: here, too. Its build script tells cargo
# to watch headers that it writes itself. They are newer than the moment at which the script began, so the next build
# runs the script again, and compiles all that rests on it. A third one builds nothing.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import subprocess

from place import PLACE, compare

package = PLACE / "package"
(package / "src").mkdir(parents=True)
(package / "src/main.rs").write_text("fn main() {}\n")
(package / "Cargo.toml").write_text(
    '[package]\nname = "package"\nversion = "0.0.0"\nedition = "2021"\n'
    '[dependencies]\neclipse-cyclonedds-sys = { version = "=0.0.4", features = ["vendored"] }\n'
)
seen = {}
for build in ["first", "second", "third"]:
    command = ["cargo", "build", "--manifest-path", package / "Cargo.toml"]
    result = subprocess.run(command, check=True, capture_output=True, text=True)
    seen[build] = "Compiling eclipse-cyclonedds-sys" in result.stderr
compare(seen, {"first": True, "second": True, "third": False})
END
