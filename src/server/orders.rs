//! Ordering rigs, the same for every door: from a mesh, and anew from an earlier rig with an edited skeleton.

use super::App;
use super::http::authenticate::Identity;
use super::http::error::{ApiError, Code};
use super::http::receive::Order;
use super::http::webhooks;
use super::http::wishes::{Wishes, WishesReader};
use crate::jobs::{ExistingRigPolicy, Job, JobState, RigOptions, Source, Submission, Submitted, canonical_skeleton};
use std::time::SystemTime;

const CLIENT_ID_MAX: usize = 64;

/// What is said of the job beside what it is to make.
#[derive(Clone, Debug)]
pub struct Terms {
    /// The id that the caller gives the job.
    pub client_id: Option<String>,
    pub idempotency_key: Option<String>,
    /// Take the result of an earlier equal job when there is one.
    pub use_cache: bool,
    /// When the result is of no use any more.
    pub deadline: Option<SystemTime>,
}

/// An id of the caller's that can be told from one of ours.
pub fn client_id(field: &str, id: String) -> Result<String, ApiError> {
    let fit = |letter: char| letter.is_ascii_alphanumeric() || ['.', '-', '_'].contains(&letter);
    if !(1..=CLIENT_ID_MAX).contains(&id.len()) || !id.chars().all(fit) || id.starts_with("rig_") {
        let detail = format!(
            "an id of your own has 1 to {CLIENT_ID_MAX} letters, digits, `.`, `-` or `_`, and does not begin with rig_"
        );
        return Err(ApiError::field(field, detail));
    }
    Ok(id)
}

/// Refuses before an upload is received, if no job with `options` would be taken. A request that may have been answered
/// before is answered again even then.
pub async fn admit(app: &App, options: &RigOptions, may_be_known: bool) -> Result<(), ApiError> {
    if may_be_known {
        app.jobs.ready()?
    } else {
        app.jobs.admit(options).await?
    }
    Ok(())
}

/// Queues a job, or finds it.
pub async fn place(app: &App, identity: &Identity, order: Order, terms: Terms) -> Result<Submitted, ApiError> {
    let Order { source, wishes } = order;
    admit_webhook(app, identity, &wishes).await?;
    Ok(app.jobs.submit(submission(identity, source, wishes, terms)).await?)
}

async fn admit_webhook(app: &App, identity: &Identity, wishes: &Wishes) -> Result<(), ApiError> {
    match &wishes.webhook {
        Some(webhook) => webhooks::admit(app, &identity.caller, webhook).await,
        None => Ok(()),
    }
}

fn submission(identity: &Identity, source: Source, wishes: Wishes, terms: Terms) -> Submission {
    let Wishes { options, priority, labels, timeout, retention, webhook } = wishes;
    let Terms { client_id, idempotency_key, use_cache, deadline } = terms;
    Submission {
        priority,
        labels,
        timeout,
        deadline,
        retention,
        client_id,
        idempotency_key,
        use_cache,
        jobs_max: identity.jobs_max,
        webhook,
        ..Submission::new(identity.caller.clone(), source, options)
    }
}

/// A job that makes weights for an edited skeleton of an earlier one.
pub struct Reskin {
    of: Job,
    wishes: Wishes,
}

impl Reskin {
    /// `asked` has read the fields named in `fields`; the others are as the earlier job had them.
    pub fn prepare(app: &App, of: Job, mut asked: WishesReader, fields: &[&str]) -> Result<Self, ApiError> {
        if fields.contains(&"skeleton") {
            return Err(ApiError::field("skeleton", "is sent beside the options, not among them"));
        }
        let levels = ["detail", "bandwidth"];
        for (name, value) in of.request.options.to_json().as_object().into_iter().flatten() {
            // Detail and bandwidth stand for each other: one that is asked for replaces either.
            let replaced = |asked: &&str| asked == name || (levels.contains(asked) && levels.contains(&name.as_str()));
            if name != "skeleton" && !fields.iter().any(replaced) {
                asked.json(name, value);
            }
        }
        let mut wishes = asked.finish(app.jobs.settings())?;
        if wishes.options.existing_rig == ExistingRigPolicy::Reskin {
            // The edited skeleton takes the place of the one that the file had.
            wishes.options.existing_rig = ExistingRigPolicy::Replace;
        }
        app.jobs.ready()?;
        if of.state == JobState::Expired {
            return Err(
                ApiError::new(Code::Expired, "the files of this job are no longer kept").hint("rig the mesh again")
            );
        }
        Ok(Self { of, wishes })
    }

    /// Queues it, or finds it. `skeleton` is a `rig.json`.
    pub async fn place(
        self,
        app: &App,
        identity: &Identity,
        skeleton: &[u8],
        terms: Terms,
    ) -> Result<Submitted, ApiError> {
        let skeleton = canonical_skeleton(skeleton, !self.wishes.options.locked_joints.is_empty())?;
        admit_webhook(app, identity, &self.wishes).await?;
        let submission = Submission {
            skeleton: Some(skeleton.into()),
            ..submission(identity, Source::Job(self.of.id), self.wishes, terms)
        };
        Ok(app.jobs.submit(submission).await?)
    }
}
