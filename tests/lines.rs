//! Checks that no package grows unseen.

use std::path::Path;

/// Most lines of Rust in `src` of each package, a little above what they have.
const LIMITS: [(&str, usize); 4] =
    [(".", 17_500), ("emulator", 5_600), ("recording", 7_718), ("urg", 16_050)];

fn lines(folder: &Path) -> usize {
    let paths = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let count = |path: &Path| match path.extension().is_some_and(|extension| extension == "rs") {
        true => std::fs::read_to_string(path).unwrap().lines().count(),
        false if path.is_dir() => lines(path),
        false => 0,
    };
    paths.map(|path| count(&path)).sum()
}

#[test]
fn no_package_grows_unseen() {
    for (package, limit) in LIMITS {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(package).join("src");
        let lines = lines(&folder);
        let advice = "say it with fewer, or raise the limit in the commit that needs them";
        assert!(lines <= limit, "{package}/src has {lines} lines of Rust, not {limit}: {advice}");
    }
}
