//! A part of a file as a response body, read in chunks by a thread that may block.

use axum::body::{Body, HttpBody};
use bytes::Bytes;
use http_body::{Frame, SizeHint};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::pin::Pin;
use std::task::{Context, Poll};
use tokio::sync::mpsc;

const CHUNK_BYTES: u64 = 256 * 1024;
/// Chunks read ahead of the socket.
const CHUNKS_AHEAD: usize = 2;

/// `bytes` bytes of `file` from `offset`. The thread ends with the body, whether or not it was read to the end.
pub fn file_body(file: File, offset: u64, bytes: u64) -> Body {
    let (sender, chunks) = mpsc::channel(CHUNKS_AHEAD);
    tokio::task::spawn_blocking(move || {
        if let Err(error) = send(file, offset, bytes, &sender) {
            tracing::error!(%error, "an artifact could not be read");
            // Nobody listens any more: then nobody needs the error.
            let _ = sender.blocking_send(Err(error));
        }
    });
    Body::new(FileBody { chunks, bytes_left: bytes })
}

fn send(mut file: File, offset: u64, bytes: u64, sender: &mpsc::Sender<io::Result<Bytes>>) -> io::Result<()> {
    file.seek(SeekFrom::Start(offset))?;
    let mut left = bytes;
    while left > 0 {
        let mut chunk = vec![0; left.min(CHUNK_BYTES) as usize];
        file.read_exact(&mut chunk)?;
        left -= chunk.len() as u64;
        if sender.blocking_send(Ok(chunk.into())).is_err() {
            return Ok(());
        }
    }
    Ok(())
}

struct FileBody {
    chunks: mpsc::Receiver<io::Result<Bytes>>,
    bytes_left: u64,
}

impl HttpBody for FileBody {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        let chunk = std::task::ready!(self.chunks.poll_recv(context));
        if let Some(Ok(bytes)) = &chunk {
            self.bytes_left = self.bytes_left.saturating_sub(bytes.len() as u64);
        }
        Poll::Ready(chunk.map(|chunk| chunk.map(Frame::data)))
    }

    fn is_end_stream(&self) -> bool {
        self.bytes_left == 0
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::with_exact(self.bytes_left)
    }
}
