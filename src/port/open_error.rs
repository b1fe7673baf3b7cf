//! Converts a failure to open a serial port into an [`ErrorKind`] that names the remedy, from
//! the system's error and the state of the device file.

use std::io;
use std::sync::Arc;

use tokio_serial::ErrorKind as Cause;

use crate::ErrorKind;

/// Text of the nix crate.
const EBUSY: &str = "Device or resource busy";

/// Device file at a port's path.
#[derive(Debug, Clone)]
struct Node {
    /// True if it can be a serial port.
    is_device: bool,
    /// Group whose members may open it, if joining the group is good advice.
    group: Option<String>,
    /// True if it appeared, or changed its owner, within the last seconds. A new device
    /// belongs to root until udev has set its group.
    is_new: bool,
    /// True if it is a pseudo-terminal that no program has open. Its lock outlives its programs.
    is_abandoned: bool,
}

/// Fails if `port` is not a serial port. Runs before opening, because opening another
/// kind of file or device can have side effects.
pub(super) fn check_before_opening(port: &str) -> Result<(), ErrorKind> {
    match node(port) {
        Ok(node) if node.is_device => Ok(()),
        Ok(_) => Err(ErrorKind::NotASerialPort { port: port.to_owned() }),
        Err(error) => Err(not_found(port, error)),
    }
}

/// Converts the error of opening `port`.
pub(super) fn explain(port: &str, error: tokio_serial::Error) -> ErrorKind {
    explain_with(port, error, node(port))
}

fn explain_with(port: &str, error: tokio_serial::Error, node: io::Result<Node>) -> ErrorKind {
    let node = match node {
        Ok(node) => node,
        // Unplugged while being opened: the first error does not matter.
        Err(error) => return not_found(port, error),
    };
    let port = port.to_owned();
    // Of an errno, serialport keeps only the text of the nix crate, which is the same in every locale.
    match (error.kind(), error.description.as_str()) {
        // The lock of a program that was killed. A lock by flock(2) ends with its program.
        (Cause::NoDevice, EBUSY) if node.is_abandoned => {
            let source = io::Error::other(
                "a program that has ended left it locked (TIOCEXCL), and no program has it open: restart the program that provides this terminal",
            );
            ErrorKind::Open { port, source: Arc::new(source) }
        }
        // EBUSY: locked with TIOCEXCL by another process. On Windows access denied, which for
        // an existing port means that it is open.
        (Cause::NoDevice, _) => ErrorKind::Busy { port },
        (Cause::Io(io::ErrorKind::NotFound), _)
        | (Cause::Unknown, "No such device" | "No such device or address") => {
            ErrorKind::NoSuchPort { port }
        }
        (Cause::Unknown, "Not a typewriter") => ErrorKind::NotASerialPort { port },
        (Cause::Io(io::ErrorKind::PermissionDenied), _) if !node.is_new => {
            ErrorKind::PermissionDenied { port, group: node.group }
        }
        // EPERM: a container or a sandbox without the device. Joining a group does not help there.
        (Cause::Unknown, "Operation not permitted") => {
            ErrorKind::PermissionDenied { port, group: None }
        }
        _ => ErrorKind::Open { port, source: Arc::new(error.into()) },
    }
}

fn not_found(port: &str, error: io::Error) -> ErrorKind {
    match error.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => {
            ErrorKind::NoSuchPort { port: port.to_owned() }
        }
        io::ErrorKind::PermissionDenied => {
            ErrorKind::PermissionDenied { port: port.to_owned(), group: None }
        }
        _ => ErrorKind::Open { port: port.to_owned(), source: Arc::new(error) },
    }
}

#[cfg(unix)]
fn node(port: &str) -> io::Result<Node> {
    use std::os::unix::fs::{FileTypeExt, MetadataExt};
    use std::path::Path;
    use std::time::{SystemTime, UNIX_EPOCH};

    let metadata = std::fs::metadata(port)?;
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    Ok(Node {
        is_device: metadata.file_type().is_char_device(),
        group: group_to_join(metadata.mode(), metadata.gid(), Path::new("/etc/group")),
        is_new: is_new(metadata.ctime(), now),
        is_abandoned: std::fs::canonicalize(port).is_ok_and(|terminal| is_abandoned(&terminal)),
    })
}

/// Returns true if `terminal` is a pseudo-terminal that no program has open, as far as this user
/// may know. Only root and the owner of a pseudo-terminal may open it.
#[cfg(unix)]
fn is_abandoned(terminal: &std::path::Path) -> bool {
    let entries = |path| std::fs::read_dir(path).into_iter().flatten().flatten();
    let mut files = entries("/proc".into()).flat_map(|program| entries(program.path().join("fd")));
    terminal.starts_with("/dev/pts")
        && !files.any(|file| std::fs::read_link(file.path()).is_ok_and(|open| open == terminal))
}

/// Group whose members may open a device: its name in the file `groups` (/etc/group), or its number,
/// which `usermod` also accepts. `None` if the group may not read and write, and for root's group.
#[cfg(unix)]
fn group_to_join(mode: u32, gid: u32, groups: &std::path::Path) -> Option<String> {
    const GROUP_READ_WRITE: u32 = 0o060;
    if gid == 0 || mode & GROUP_READ_WRITE != GROUP_READ_WRITE {
        return None;
    }
    let groups = std::fs::read_to_string(groups).unwrap_or_default();
    let name = groups.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        let number: u32 = fields.nth(1)?.parse().ok()?;
        (number == gid).then(|| name.to_owned())
    });
    Some(name.unwrap_or_else(|| gid.to_string()))
}

/// Returns true if the owner or mode of a device changed (at `changed`, in seconds since
/// 1970) within the three seconds before `now`. udev needs some tens of milliseconds, and
/// more on a small machine that is booting.
#[cfg(unix)]
fn is_new(changed: i64, now: u64) -> bool {
    u64::try_from(changed).is_ok_and(|changed| (changed..=changed.saturating_add(3)).contains(&now))
}

/// Ports are not files here. The system reports the same error for a missing port and for
/// one in use: a listed port is in use.
#[cfg(not(unix))]
fn node(port: &str) -> io::Result<Node> {
    use super::list::{available, is_same};

    if available().is_ok_and(|ports| ports.iter().any(|listed| is_same(&listed.port_name, port))) {
        Ok(Node { is_device: true, group: None, is_new: false, is_abandoned: false })
    } else {
        Err(io::ErrorKind::NotFound.into())
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::ErrorChain;

    #[test]
    fn o05_each_failure_names_its_remedy() {
        const DENIED: io::ErrorKind = io::ErrorKind::PermissionDenied;
        let group = Some("dialout".to_owned());
        let node = Node { is_device: true, group, is_new: false, is_abandoned: false };
        let new = Node { is_new: true, ..node.clone() };
        let here = || Ok(node.clone());
        let missing = |kind: io::ErrorKind| Err(kind.into());
        for (cause, text, node, remedy, is_transient) in [
            (Cause::Io(DENIED), "", here(), "`sudo usermod -aG dialout $USER`", false),
            // udev is about to give it to its group.
            (Cause::Io(DENIED), "Permission denied", Ok(new), "cannot open port: Permission", true),
            // In a container, and in a folder that is closed to the user, a group does not help.
            (Cause::Unknown, "Operation not permitted", here(), "give the user read and", false),
            (Cause::Unknown, "", missing(DENIED), "give the user read and", false),
            (Cause::NoDevice, "Unable to acquire exclusive lock", here(), "port is in use", true),
            // Unplugged while it was opened.
            (Cause::Unknown, "I/O error", missing(io::ErrorKind::NotFound), "no port", true),
            // A name without a device.
            (Cause::Unknown, "No such device", here(), "no port", true),
            (Cause::Unknown, "I/O error", here(), "cannot open port: I/O error", true),
            (Cause::Unknown, "", missing(io::ErrorKind::TimedOut), "cannot open port: timed", true),
        ] {
            let kind = explain_with("port", tokio_serial::Error::new(cause, text), node);
            let found = ErrorChain(&kind).to_string();
            assert!(found.contains(remedy), "{found}");
            assert_eq!(kind.is_transient(), is_transient, "{found}");
        }
    }

    #[test]
    fn the_group_is_named_where_joining_it_helps() -> io::Result<()> {
        let file = format!("tokio-scip-groups-{}", std::process::id());
        let file = std::env::temp_dir().join(file);
        std::fs::write(&file, "root:x:0:\nbroken\ndialout:x:20:ada,bob\nuucp:x:10:\n")?;
        let named = |mode, gid| group_to_join(mode, gid, &file);
        assert_eq!(named(0o020_660, 20).as_deref(), Some("dialout"));
        assert_eq!(named(0o020_660, 10).as_deref(), Some("uucp"));
        assert_eq!(named(0o020_660, 977).as_deref(), Some("977"), "not in /etc/group");
        assert_eq!(named(0o020_620, 20), None, "the group may only write");
        assert_eq!(named(0o020_660, 0), None, "nobody is told to join root's group");
        std::fs::remove_file(&file)?;
        assert_eq!(named(0o020_660, 20).as_deref(), Some("20"), "there is no /etc/group");
        Ok(())
    }

    #[test]
    fn a_device_is_new_for_three_seconds() {
        assert!(is_new(1_000, 1_000));
        assert!(is_new(1_000, 1_003));
        assert!(!is_new(1_000, 1_004));
        assert!(!is_new(1_000, 999), "from the future: the clock was set");
        assert!(!is_new(-5, 1_000));
    }
}
