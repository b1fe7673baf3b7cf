//! The head of a request, read before HTTP parses it. HTTP takes its buffers at once, and
//! a client that sends a head byte by byte, or none, would hold them.

use std::io;

use tokio::net::TcpStream;

/// Reads until the head of a request has arrived, or `limit` bytes. Returns what was
/// read, perhaps with a part of the body; `None` if the client has closed the connection.
///
/// Does not check the head: HTTP parses it, and refuses one that is too long.
pub(super) async fn read(stream: &mut TcpStream, limit: usize) -> io::Result<Option<Vec<u8>>> {
    let mut head = Vec::new();
    loop {
        stream.readable().await?;
        // On the stack only while it is used, and not in the task.
        let mut buffer = [0; 1024];
        let count = match stream.try_read(&mut buffer) {
            Ok(0) => return Ok(None),
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => continue,
            Err(error) => return Err(error),
        };
        let mut bytes = buffer.get(..count).unwrap_or_default();
        if head.is_empty() {
            // Empty lines before a request are skipped, and end nothing.
            let start = bytes.iter().position(|byte| !b"\r\n".contains(byte));
            bytes = bytes.get(start.unwrap_or(count)..).unwrap_or_default();
        }
        // The empty line may have begun in the bytes before.
        let searched = head.len().saturating_sub(2);
        head.extend_from_slice(bytes);
        if has_empty_line(head.get(searched..).unwrap_or_default()) || head.len() >= limit {
            return Ok(Some(head));
        }
    }
}

/// Returns whether an empty line, which ends a head, is in the bytes. A line may end with
/// LF alone.
fn has_empty_line(bytes: &[u8]) -> bool {
    bytes.windows(2).any(|bytes| bytes == b"\n\n")
        || bytes.windows(3).any(|bytes| bytes == b"\n\r\n")
}

#[cfg(test)]
mod tests {
    use tokio::io::AsyncWriteExt;
    use tokio::net::TcpListener;

    use super::*;

    /// Returns what is read from a client that sends the pieces, and then closes.
    async fn read_of(pieces: &[&[u8]]) -> Option<Vec<u8>> {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let mut client = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
        let (mut server, _) = listener.accept().await.unwrap();
        let send = async {
            for piece in pieces {
                client.write_all(piece).await.unwrap();
                tokio::task::yield_now().await;
            }
            drop(client);
        };
        let (head, ()) = tokio::join!(read(&mut server, 4096), send);
        head.unwrap()
    }

    #[tokio::test]
    async fn a_head_is_read_to_its_empty_line_in_any_pieces() {
        for head in ["GET / HTTP/1.1\r\nHost: a\r\n\r\n", "GET / HTTP/1.0\n\n", "GET /\n\r\n"] {
            let bytes: Vec<_> = head.as_bytes().chunks(1).collect();
            assert_eq!(read_of(&bytes).await.as_deref(), Some(head.as_bytes()));
            assert_eq!(read_of(&[head.as_bytes()]).await.as_deref(), Some(head.as_bytes()));
        }
    }

    #[tokio::test]
    async fn empty_lines_before_a_request_are_skipped() {
        let request = b"GET / HTTP/1.1\r\n\r\n";
        let pieces: [&[u8]; 4] = [b"\r\n", b"\r\n\nGET ", b"/ HTTP/1.1\r\n\r", b"\n"];
        assert_eq!(read_of(&pieces).await.as_deref(), Some(&request[..]));
    }

    #[tokio::test]
    async fn a_client_that_closes_before_the_end_of_the_head_has_sent_none() {
        assert_eq!(read_of(&[]).await, None);
        assert_eq!(read_of(&[b"GET / HTTP/1.1\r\nHost: a\r\n\r"]).await, None);
    }

    #[tokio::test]
    async fn a_head_without_end_is_read_to_the_limit() {
        let head = read_of(&[&[b'a'; 8192]]).await.unwrap();
        assert!((4096..4096 + 1024).contains(&head.len()), "{}", head.len());
    }
}
