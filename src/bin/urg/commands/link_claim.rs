//! The claim of a running `urg emulate` to its link. A link alone does not show
//! whether its emulator still runs: the number of a pseudo-terminal is used again.
//! A socket in Linux's abstract namespace does, and ends with the process.

use std::path::Path;

use crate::failure::Failure;

/// A link that no other emulator replaces until the drop. On systems other than
/// Linux nothing is claimed.
#[derive(Debug)]
pub(super) struct LinkClaim {
    #[cfg(target_os = "linux")]
    _socket: std::os::unix::net::UnixDatagram,
}

impl LinkClaim {
    /// Claims the link at `path`. Fails if another emulator has claimed it.
    #[cfg(target_os = "linux")]
    pub(super) fn take(path: &Path) -> Result<Self, Failure> {
        use std::hash::{DefaultHasher, Hash, Hasher};
        use std::io;
        use std::os::linux::net::SocketAddrExt;
        use std::os::unix::net::{SocketAddr, UnixDatagram};

        // The link itself may exist or not, its directory has to.
        let directory = match path.parent() {
            Some(directory) if !directory.as_os_str().is_empty() => directory,
            _ => Path::new("."),
        };
        let directory = directory.canonicalize().unwrap_or_else(|_| directory.to_owned());
        let mut hasher = DefaultHasher::new();
        (directory, path.file_name()).hash(&mut hasher);
        let name = format!("urg-emulate-{:016x}", hasher.finish());
        let socket = SocketAddr::from_abstract_name(name)
            .and_then(|address| UnixDatagram::bind_addr(&address));
        match socket {
            Ok(socket) => Ok(Self { _socket: socket }),
            Err(error) if error.kind() == io::ErrorKind::AddrInUse => {
                Err(Failure::Failed(format!(
                    "cannot serve on {}: another `urg emulate` is serving there; stop it first, \
                     or use another --link",
                    path.display()
                )))
            }
            Err(error) => Err(Failure::of(&format!("cannot serve on {}", path.display()), &error)),
        }
    }

    #[cfg(not(target_os = "linux"))]
    #[expect(clippy::unnecessary_wraps, reason = "it fails on Linux")]
    pub(super) fn take(_: &Path) -> Result<Self, Failure> {
        Ok(Self {})
    }
}
