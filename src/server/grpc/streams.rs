//! Calls that stream: an upload, the events of a job, a file.

use super::super::App;
use super::super::http::artifacts;
use super::super::http::error::{ApiError, Code};
use super::super::http::media;
use super::super::http::sink::Sink;
use super::super::uploads::{Files, empty};
use super::proto::rigsmith::v1::upload_chunk::Part;
use super::proto::rigsmith::v1::{Chunk, RigEvent, UploadChunk, UploadFile};
use crate::jobs::{ArtifactInfo, ErrorCode, Events, Received};
use std::pin::Pin;
use tokio::sync::{mpsc, watch};
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt, once};
use tonic::{Status, Streaming};

pub type RigEvents = ReceiverStream<Result<RigEvent, Status>>;
pub type Chunks = Pin<Box<dyn Stream<Item = Result<Chunk, Status>> + Send>>;

/// Events read ahead of a slow reader.
const EVENTS_AHEAD: usize = 16;

/// Receives the files of an asset. Gives the request id with them.
pub async fn receive(app: &App, mut chunks: Streaming<UploadChunk>) -> Result<(Received, String), Status> {
    let mut sink = Sink::open(app)?;
    let mut files = Files::default();
    let (mut current, mut request_id) = (None, None);
    while let Some(UploadChunk { part, request_id: id }) = chunks.message().await? {
        request_id.get_or_insert(id);
        match part {
            Some(Part::File(UploadFile { name, main })) => {
                end(&mut sink, current.as_deref()).await?;
                let name = files.add(if main { "file" } else { "files" }, &name)?;
                sink.begin(&name).await?;
                current = Some(name);
            }
            Some(Part::Data(data)) if current.is_some() => sink.push(data).await?,
            Some(Part::Data(_)) => {
                return Err(ApiError::field("file", "is missing: the first message names a file").into());
            }
            None => return Err(ApiError::field("part", "is missing: a message has a file or data").into()),
        }
    }
    end(&mut sink, current.as_deref()).await?;
    let main = files.main().map_err(|error| error.hint("begin the mesh with a file whose main is true"))?;
    sink.refuse_foreign(&main)?;
    Ok((sink.finish(&main).await?, request_id.unwrap_or_default()))
}

/// The end of one file.
async fn end(sink: &mut Sink, name: Option<&str>) -> Result<(), ApiError> {
    sink.flush().await?;
    match name {
        Some(name) if sink.file_bytes() == 0 && media::is_mesh_name(name) => Err(empty(name)),
        _ => Ok(()),
    }
}

/// Events as they come, until there are no more, nobody listens, or the service stops.
pub fn watch(app: &App, events: Events) -> RigEvents {
    let (told, received) = mpsc::channel(EVENTS_AHEAD);
    tokio::spawn(follow(events, app.closing.subscribe(), told));
    ReceiverStream::new(received)
}

async fn follow(mut events: Events, mut closing: watch::Receiver<bool>, told: mpsc::Sender<Result<RigEvent, Status>>) {
    if events.is_over() {
        return;
    }
    loop {
        let next = tokio::select! {
            next = events.next() => next,
            () = async { _ = closing.wait_for(|closing| *closing).await } => {
                let stopping = ApiError::new(Code::Work(ErrorCode::Draining), "the service is stopping")
                    .hint("watch again with after_sequence");
                // Nobody may be there to hear it.
                let _ = told.send(Err(stopping.into())).await;
                return;
            }
            () = told.closed() => return,
        };
        let item = match next {
            Ok(Some(event)) => Ok(RigEvent::from(&event)),
            Ok(None) => return,
            Err(error) => Err(ApiError::from(error).into()),
        };
        let failed = item.is_err();
        if told.send(item).await.is_err() || failed {
            return;
        }
    }
}

/// What a file is, then its bytes from `offset` on.
pub async fn download(app: &App, artifact: &ArtifactInfo, offset: u64) -> Result<Chunks, ApiError> {
    let left = artifact.bytes.checked_sub(offset).ok_or_else(|| artifacts::outside(artifact))?;
    let content = app.jobs.open(&artifact.sha256).await?.ok_or_else(artifacts::expired)?;
    let bytes = match content.stream(offset, left).await {
        Err(error) if error.is_missing() => return Err(artifacts::expired()),
        bytes => bytes.map_err(|error| ApiError::internal(&error))?,
    };
    let first = Chunk { artifact: Some(artifact.into()), data: bytes::Bytes::new() };
    let rest = bytes.map(|data| match data {
        Ok(data) => Ok(Chunk { artifact: None, data }),
        Err(error) => Err(ApiError::internal(&error).into()),
    });
    Ok(Box::pin(once(Ok(first)).chain(rest)))
}
