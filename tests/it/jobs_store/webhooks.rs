//! Webhooks: what is written, who sends it, how often, and what endpoints' answers do.

use super::engines::{Bench, DAY, alice, bob};
use rigsmith::jobs::store::webhooks::{DELIVERY_LEASE, TOGETHER};
use rigsmith::jobs::store::{EndedWithout, Ending, LEASE, NewJob};
use rigsmith::jobs::webhooks::{
    Delivery, DeliveryState, DueDelivery, ENDPOINTS_MAX, Endpoint, EndpointChange, JobWebhook, KEEP_TIME, MessageType,
    NewEndpoint, NewEndpointIs, REST, ROTATION_TIME, SCHEDULE, Secret, Subject, Tried, Verdict,
};
use rigsmith::jobs::{Caller, EndpointId, JobState, MessageId, NewBatch, NewItem, Settled};
use std::collections::BTreeSet;
use std::time::{Duration, SystemTime};

async fn make(bench: &Bench, caller: Caller, url: Option<&str>, events: &[MessageType]) -> NewEndpointIs {
    let new = NewEndpoint {
        caller,
        url: url.map(str::to_owned),
        description: String::new(),
        events: events.to_vec(),
        secret: Secret::new().expect("random bytes"),
    };
    bench.store.create_endpoint(new).await.expect("answers")
}

async fn endpoint(bench: &Bench, caller: Caller, events: &[MessageType]) -> Endpoint {
    match make(bench, caller, Some("https://studio.example/hooks"), events).await {
        NewEndpointIs::Made(endpoint) => endpoint,
        other => panic!("not made: {other:?}"),
    }
}

/// The endpoint of what single jobs want told.
async fn of_jobs(bench: &Bench, caller: Caller) -> Endpoint {
    match make(bench, caller, None, &[]).await {
        NewEndpointIs::Made(endpoint) => endpoint,
        other => panic!("not made: {other:?}"),
    }
}

async fn everything(bench: &Bench) -> Endpoint {
    endpoint(bench, alice(), &MessageType::ALL).await
}

async fn told(bench: &Bench, endpoint: EndpointId) -> Vec<Delivery> {
    let mut deliveries = bench.store.deliveries(endpoint, None, None, 1000).await.expect("answers");
    deliveries.reverse();
    deliveries
}

async fn kinds(bench: &Bench, endpoint: &Endpoint) -> Vec<MessageType> {
    told(bench, endpoint.id).await.iter().map(|delivery| delivery.kind).collect()
}

async fn claim(bench: &Bench) -> Vec<DueDelivery> {
    bench.store.claim_deliveries(100).await.expect("answers")
}

/// The only message that is due.
async fn only(bench: &Bench) -> DueDelivery {
    let mut due = claim(bench).await;
    assert_eq!(due.len(), 1);
    due.remove(0)
}

fn answer(status: u16) -> Tried {
    let error = (!(200..300).contains(&status)).then(|| format!("it answered {status}"));
    Tried { duration: Duration::from_millis(20), status: Some(status), error, retry_after: None }
}

async fn note(bench: &Bench, due: &DueDelivery, tried: Tried) -> Option<Verdict> {
    bench.store.note_attempt(due, &tried).await.expect("answers")
}

async fn delivery(bench: &Bench, endpoint: EndpointId, message: MessageId) -> Delivery {
    bench.store.delivery(endpoint, message).await.expect("answers").expect("is there")
}

async fn test(bench: &Bench, endpoint: &Endpoint) -> MessageId {
    bench.store.test_endpoint(endpoint.id).await.expect("answers")
}

/// A message that is tried by the whole schedule, and nothing else.
async fn message(bench: &Bench) -> (Endpoint, MessageId) {
    let endpoint = endpoint(bench, alice(), &[MessageType::RigSucceeded]).await;
    bench.done("a mesh").await;
    (endpoint.clone(), told(bench, endpoint.id).await[0].message)
}

pub async fn what_happens_is_told_to_whoever_wants_it_and_to_nobody_else(bench: &Bench) {
    let all = everything(bench).await;
    let few = endpoint(bench, alice(), &[MessageType::RigFailed, MessageType::RigCanceled]).await;
    let foreign = endpoint(bench, bob(), &MessageType::ALL).await;
    let off = everything(bench).await;
    let change = EndpointChange { enabled: Some(false), ..EndpointChange::default() };
    bench.store.change_endpoint(&alice(), off.id, change).await.expect("answers");
    use MessageType::{RigCanceled, RigFailed, RigStarted, RigSucceeded};
    bench.done("a").await;
    assert_eq!(kinds(bench, &all).await, [RigStarted, RigSucceeded]);
    bench.add(bench.new_job("a")).await;
    assert_eq!(kinds(bench, &all).await, [RigStarted, RigSucceeded, RigSucceeded], "an equal job never ran");
    bench.add(bench.new_job("b")).await;
    let taken = bench.take().await;
    bench.finish(&taken, bench.failed()).await;
    let waiting = bench.add(bench.new_job("c")).await;
    bench.store.cancel(&alice(), waiting).await.expect("answers");
    assert_eq!(kinds(bench, &few).await, [RigFailed, RigCanceled]);
    assert_eq!(kinds(bench, &all).await[3..], [RigStarted, RigFailed, RigCanceled]);
    bench.add(bench.new_job("d")).await;
    let taken = bench.take().await;
    let canceled = Ending { outcome: Err(EndedWithout::Canceled), stage: None, timings: Vec::new() };
    bench.finish(&taken, canceled).await;
    assert_eq!(kinds(bench, &all).await[6..], [RigStarted, RigCanceled]);
    for nobody in [&foreign, &off] {
        assert_eq!(kinds(bench, nobody).await, []);
    }
}

pub async fn work_that_begins_anew_is_not_told_again(bench: &Bench) {
    let all = everything(bench).await;
    bench.add(bench.new_job("a")).await;
    let first = bench.take().await;
    assert!(bench.store.give_back(first.lease).await.expect("answers"));
    bench.take().await;
    bench.advance(LEASE + Duration::from_secs(1));
    bench.sweep().await;
    bench.take().await;
    assert_eq!(kinds(bench, &all).await, [MessageType::RigStarted]);
    bench.advance(LEASE + Duration::from_secs(1));
    bench.sweep().await;
    assert_eq!(kinds(bench, &all).await, [MessageType::RigStarted, MessageType::RigFailed], "its workers were lost");
}

pub async fn a_message_tells_of_the_rig_as_it_was_then(bench: &Bench) {
    everything(bench).await;
    let id = bench.done("a").await;
    bench.store.delete(&alice(), id).await.expect("answers");
    let due = claim(bench).await;
    let told: Vec<(MessageType, JobState, bool)> = due
        .iter()
        .map(|due| match &due.message.subject {
            Subject::Rig(job) if job.id == id => (due.message.kind, job.state, job.result.is_some()),
            other => panic!("{other:?}"),
        })
        .collect();
    let expected =
        [(MessageType::RigStarted, JobState::Running, false), (MessageType::RigSucceeded, JobState::Succeeded, true)];
    assert_eq!(told, expected);
    assert!(due[0].message.sequence() < due[1].message.sequence());
    assert!(due.iter().all(|due| due.message.at == SystemTime::from(bench.now())));
}

pub async fn the_end_of_a_batch_is_told_once(bench: &Bench) {
    let all = endpoint(bench, alice(), &[MessageType::BatchCompleted]).await;
    let item = |name: &str| NewItem { custom_id: name.to_owned(), request: "{}".to_owned(), asset: None, error: None };
    let new = NewBatch { caller: alice(), jobs_max: None, items: vec![item("a"), item("b")] };
    let id = bench.store.create_batch(new).await.expect("answers");
    let job = bench.done("a").await;
    bench.store.settle_item(id, 0, &Settled::Job(job)).await.expect("answers");
    bench.store.conclude_batches().await.expect("answers");
    assert_eq!(kinds(bench, &all).await, []);
    bench.store.settle_item(id, 1, &Settled::Refused("{}".to_owned())).await.expect("answers");
    bench.store.conclude_batches().await.expect("answers");
    bench.store.conclude_batches().await.expect("answers");
    let due = only(bench).await;
    let Subject::Batch(batch) = &due.message.subject else { panic!("{due:?}") };
    assert_eq!((batch.id, batch.counts.succeeded, batch.counts.failed), (id, 1, 1));
    assert!(batch.finished_at.is_some());
}

pub async fn a_message_is_sent_by_one_and_by_another_when_that_one_is_lost(bench: &Bench) {
    let (endpoint, id) = message(bench).await;
    let first = only(bench).await;
    assert_eq!((first.attempt, first.endpoint, first.message.id), (1, endpoint.id, id));
    let elsewhere = async || bench.second.claim_deliveries(100).await.expect("answers");
    assert!(elsewhere().await.is_empty(), "it is under way");
    bench.advance(DELIVERY_LEASE + Duration::from_secs(1));
    let second = elsewhere().await.remove(0);
    assert_eq!(second.attempt, 2);
    assert_eq!(note(bench, &first, answer(200)).await, None, "a late word changes nothing");
    assert_eq!(delivery(bench, endpoint.id, id).await.state, DeliveryState::Pending);
    assert_eq!(note(bench, &second, answer(204)).await, Some(Verdict::Delivered));
    assert_eq!(note(bench, &second, answer(204)).await, None, "once");
    let over = delivery(bench, endpoint.id, id).await;
    assert_eq!((over.state, over.next_attempt_at), (DeliveryState::Delivered, None));
    let log: Vec<(u32, Option<u16>)> = over.attempts.iter().map(|attempt| (attempt.number, attempt.status)).collect();
    assert_eq!(log, [(2, Some(204))], "nobody knows how the first one went");
    bench.advance(DAY);
    assert!(claim(bench).await.is_empty());
    // When the only process comes back, what it sent is sent again at once.
    bench.store.redeliver(endpoint.id, id).await.expect("answers");
    only(bench).await;
    bench.store.lose_all().await.expect("answers");
    only(bench).await;
}

pub async fn two_senders_never_send_the_same_message_at_once(bench: &Bench) {
    for _ in 0..ENDPOINTS_MAX {
        let endpoint = everything(bench).await;
        for _ in 0..4 {
            test(bench, &endpoint).await;
        }
    }
    let mut sent = BTreeSet::new();
    let mut rounds = 0;
    while sent.len() < ENDPOINTS_MAX * 4 {
        let (ours, theirs) = tokio::join!(bench.store.claim_deliveries(7), bench.second.claim_deliveries(7));
        for due in ours.expect("answers").into_iter().chain(theirs.expect("answers")) {
            assert!(sent.insert((due.endpoint, due.message.id)), "twice: {due:?}");
            note(bench, &due, answer(200)).await;
        }
        rounds += 1;
        assert!(rounds < 1000, "{} were sent", sent.len());
    }
}

pub async fn a_message_is_tried_by_the_schedule_and_then_given_up(bench: &Bench) {
    let (endpoint, id) = message(bench).await;
    for tries in 1..=SCHEDULE.len() {
        let due = only(bench).await;
        let verdict = note(bench, &due, answer(500)).await.expect("it is ours");
        let Some(time) = SCHEDULE.get(tries) else {
            assert_eq!(verdict, Verdict::GivenUp);
            break;
        };
        let Verdict::Again(wait) = verdict else { panic!("{verdict:?} after {tries}") };
        assert!(*time <= wait && wait <= time.mul_f64(1.2), "{wait:?} after {tries} tries");
        let next = delivery(bench, endpoint.id, id).await.next_attempt_at.expect("a time");
        assert_eq!(next, SystemTime::from(bench.now().after(wait)));
        bench.advance(*time - Duration::from_millis(1));
        assert!(claim(bench).await.is_empty(), "not before its time");
        bench.advance(wait - *time + Duration::from_millis(2));
    }
    let failed = delivery(bench, endpoint.id, id).await;
    assert_eq!((failed.state, failed.attempts.len()), (DeliveryState::Failed, 10));
    assert!(failed.attempts.iter().all(|attempt| attempt.error.as_deref() == Some("it answered 500")));
    let numbers: Vec<u32> = failed.attempts.iter().map(|attempt| attempt.number).collect();
    assert_eq!(numbers, (1..=10).collect::<Vec<_>>());
    bench.advance(2 * DAY);
    assert!(claim(bench).await.is_empty(), "given up is given up");
    assert!(bench.store.redeliver(endpoint.id, id).await.expect("answers"));
    let again = only(bench).await;
    assert_eq!((again.attempt, again.message.id), (11, id), "the same message");
    let Some(Verdict::Again(wait)) = note(bench, &again, answer(500)).await else { panic!("it begins anew") };
    assert!(wait < SCHEDULE[2]);
    assert!(!bench.store.redeliver(endpoint.id, MessageId::new()).await.expect("answers"));
}

pub async fn an_endpoint_that_is_overloaded_is_left_alone(bench: &Bench) {
    let endpoint = everything(bench).await;
    let waits = Duration::from_secs(7200);
    for rest in [Some(waits), None] {
        test(bench, &endpoint).await;
        let due = only(bench).await;
        note(bench, &due, Tried { retry_after: rest, ..answer(503) }).await;
        test(bench, &endpoint).await;
        let rest = rest.unwrap_or(REST);
        bench.advance(rest - Duration::from_secs(1));
        assert!(claim(bench).await.is_empty(), "not before it wants to");
        bench.advance(Duration::from_secs(2));
        let due = only(bench).await;
        note(bench, &due, answer(200)).await;
    }
    // What is sent again later than it asked is sent by the schedule.
    bench.done("a").await;
    let due = claim(bench).await;
    let asks = Tried { retry_after: Some(waits), ..answer(400) };
    assert_eq!(note(bench, &due[0], asks).await, Some(Verdict::Again(waits)));
}

pub async fn an_endpoint_that_is_gone_is_disabled_until_its_caller_enables_it(bench: &Bench) {
    let endpoint = everything(bench).await;
    bench.done("a").await;
    let due = claim(bench).await;
    assert_eq!(note(bench, &due[0], answer(410)).await, Some(Verdict::Gone));
    let Some(Verdict::Again(wait)) = note(bench, &due[1], answer(500)).await else { panic!("it is tried again") };
    let seen = async || bench.store.endpoint(&alice(), endpoint.id).await.expect("answers").expect("is there");
    let gone = seen().await;
    assert!(!gone.enabled && gone.failing_since.is_some());
    assert!(gone.disabled_reason.is_some_and(|reason| reason.contains("410")));
    bench.done("b").await;
    bench.advance(wait);
    assert!(claim(bench).await.is_empty(), "it is told nothing");
    let change = EndpointChange { enabled: Some(true), ..EndpointChange::default() };
    bench.store.change_endpoint(&alice(), endpoint.id, change).await.expect("answers");
    assert_eq!((seen().await.enabled, seen().await.disabled_reason), (true, None));
    let due = only(bench).await;
    assert_eq!((due.message.kind, due.attempt), (MessageType::RigSucceeded, 2), "what waited goes on");
    note(bench, &due, answer(200)).await;
    assert_eq!(seen().await.failing_since, None);
    assert_eq!(kinds(bench, &endpoint).await.len(), 2, "what happened meanwhile is not told");
}

pub async fn a_failing_endpoint_gets_one_message_at_a_time_and_holds_up_no_other(bench: &Bench) {
    let (good, bad) = (everything(bench).await, everything(bench).await);
    for endpoint in [&good, &bad] {
        for _ in 0..2 * TOGETHER {
            test(bench, endpoint).await;
        }
    }
    let of = |due: &[DueDelivery], endpoint: &Endpoint| due.iter().filter(|due| due.endpoint == endpoint.id).count();
    let due = claim(bench).await;
    assert_eq!((of(&due, &good), of(&due, &bad)), (TOGETHER, TOGETHER));
    assert!(claim(bench).await.is_empty(), "no more while some are under way");
    for due in due {
        note(bench, &due, answer(if due.endpoint == good.id { 200 } else { 500 })).await;
    }
    let due = claim(bench).await;
    assert_eq!((of(&due, &good), of(&due, &bad)), (TOGETHER, 1));
    assert_eq!(claim(bench).await.len(), 0);
    assert_eq!(bench.store.claim_deliveries(0).await.expect("answers").len(), 0);
}

pub async fn two_secrets_sign_for_a_day_after_one_is_replaced(bench: &Bench) {
    let (endpoint, _) = message(bench).await;
    let (second, third) = (Secret::new().expect("random bytes"), Secret::new().expect("random bytes"));
    let replace = async |secret: &Secret| {
        let replaced = bench.store.replace_secret(&alice(), endpoint.id, secret.clone()).await.expect("answers");
        assert_eq!(replaced.expect("is there").secret, *secret);
    };
    let signing = async || {
        let due = only(bench).await;
        note(bench, &due, answer(500)).await;
        bench.store.redeliver(due.endpoint, due.message.id).await.expect("answers");
        due.secrets
    };
    assert_eq!(signing().await, std::slice::from_ref(&endpoint.secret));
    replace(&second).await;
    assert_eq!(signing().await, [second.clone(), endpoint.secret.clone()]);
    replace(&third).await;
    assert_eq!(signing().await, [third.clone(), second], "of a third one nothing is left");
    bench.advance(ROTATION_TIME);
    assert_eq!(signing().await, [third]);
    let foreign = bench.store.replace_secret(&bob(), endpoint.id, endpoint.secret.clone()).await.expect("answers");
    assert_eq!(foreign, None);
}

pub async fn what_one_job_wants_told_goes_where_it_says_and_is_a_matter_of_that_message_alone(bench: &Bench) {
    let signs = of_jobs(bench, alice()).await;
    let usual = endpoint(bench, alice(), &[MessageType::RigSucceeded]).await;
    of_jobs(bench, bob()).await;
    assert_eq!(make(bench, alice(), None, &[]).await, NewEndpointIs::Second(signs.id));
    let told_at = |path: &str, events: &[MessageType]| {
        Some(JobWebhook { url: format!("https://one.example/{path}"), events: events.to_vec() })
    };
    let ended = [MessageType::RigSucceeded, MessageType::RigFailed];
    bench.add(NewJob { webhook: told_at("a", &ended), ..bench.new_job("a") }).await;
    let taken = bench.take().await;
    assert_eq!(taken.job.request.webhook, told_at("a", &ended), "it is told with the job");
    bench.finish(&taken, bench.good("made")).await;
    let places = |due: &[DueDelivery]| {
        let mut places: Vec<_> =
            due.iter().map(|due| (due.endpoint, due.url.clone(), due.secrets[0].clone())).collect();
        places.sort_by_key(|(endpoint, url, _)| (*endpoint, url.clone()));
        places
    };
    let due = claim(bench).await;
    let expected = [
        (signs.id, "https://one.example/a".to_owned(), signs.secret.clone()),
        (usual.id, "https://studio.example/hooks".to_owned(), usual.secret.clone()),
    ];
    assert_eq!(places(&due), expected);
    assert_eq!(due[0].message.id, due[1].message.id, "one message");
    let (own, other) =
        (due.iter().find(|due| due.endpoint == signs.id), due.iter().find(|due| due.endpoint == usual.id));
    note(bench, other.expect("is there"), answer(200)).await;
    // Whatever that place answers, the messages of other jobs go to theirs.
    assert_eq!(note(bench, own.expect("is there"), answer(410)).await, Some(Verdict::Gone));
    let seen = bench.store.endpoint(&alice(), signs.id).await.expect("answers").expect("is there");
    assert!(seen.enabled && seen.failing_since.is_none());
    for (content, path) in [("b", "overloaded"), ("c", "another")] {
        bench.add(NewJob { webhook: told_at(path, &ended), ..bench.new_job(content) }).await;
        let taken = bench.take().await;
        bench.finish(&taken, bench.failed()).await;
        let due = only(bench).await;
        assert_eq!(due.url, format!("https://one.example/{path}"));
        note(bench, &due, Tried { retry_after: Some(DAY), ..answer(503) }).await;
    }
    bench.add(NewJob { webhook: told_at("d", &[MessageType::RigCanceled]), ..bench.new_job("d") }).await;
    let taken = bench.take().await;
    bench.finish(&taken, bench.failed()).await;
    assert!(claim(bench).await.is_empty(), "it asked for something else");
    // A deleted endpoint takes what it signs with it.
    bench.store.delete_endpoint(&alice(), signs.id).await.expect("answers");
    bench.add(NewJob { webhook: told_at("e", &ended), ..bench.new_job("e") }).await;
    let taken = bench.take().await;
    bench.finish(&taken, bench.failed()).await;
    bench.advance(2 * DAY);
    assert!(claim(bench).await.is_empty());
}

pub async fn endpoints_are_each_callers_own_bounded_and_forgotten_whole(bench: &Bench) {
    let first = everything(bench).await;
    for _ in 1..ENDPOINTS_MAX {
        everything(bench).await;
    }
    for url in [Some("https://studio.example/"), None] {
        assert_eq!(make(bench, alice(), url, &MessageType::ALL).await, NewEndpointIs::TooMany);
    }
    let listed = bench.second.endpoints(&alice()).await.expect("answers");
    assert_eq!((listed.len(), &listed[0]), (ENDPOINTS_MAX, &first));
    assert_eq!(bench.store.endpoints(&bob()).await.expect("answers"), []);
    assert_eq!(bench.store.endpoint(&bob(), first.id).await.expect("answers"), None);
    let change = EndpointChange {
        url: Some("https://elsewhere.example/".to_owned()),
        description: Some("moved".to_owned()),
        events: Some(vec![MessageType::RigFailed]),
        enabled: None,
    };
    let denied = bench.store.change_endpoint(&bob(), first.id, change.clone()).await.expect("answers");
    assert_eq!(denied, None);
    let changed = bench.store.change_endpoint(&alice(), first.id, change).await.expect("answers").expect("is there");
    assert_eq!((changed.url.as_deref(), changed.description.as_str()), (Some("https://elsewhere.example/"), "moved"));
    assert_eq!((changed.events, changed.enabled), (vec![MessageType::RigFailed], true));
    test(bench, &first).await;
    let due = only(bench).await;
    assert!(!bench.store.delete_endpoint(&bob(), first.id).await.expect("answers"));
    assert!(bench.store.delete_endpoint(&alice(), first.id).await.expect("answers"));
    assert_eq!(note(bench, &due, answer(200)).await, None, "what was under way is nobody's any more");
    assert_eq!(told(bench, first.id).await, []);
}

pub async fn deliveries_are_listed_by_state_and_forgotten_in_time(bench: &Bench) {
    let endpoint = everything(bench).await;
    let mut ids = Vec::new();
    for _ in 0..5 {
        ids.push(test(bench, &endpoint).await);
    }
    for (due, status) in claim(bench).await.iter().zip([200, 500, 200]) {
        note(bench, due, answer(status)).await;
    }
    let list = async |state, before, count| {
        let page = bench.store.deliveries(endpoint.id, state, before, count).await.expect("answers");
        page.iter().map(|delivery| delivery.message).collect::<Vec<_>>()
    };
    assert_eq!(list(None, None, 2).await, [ids[4], ids[3]]);
    assert_eq!(list(None, Some(ids[3]), 2).await, [ids[2], ids[1]]);
    assert_eq!(list(Some(DeliveryState::Delivered), None, 9).await, [ids[2], ids[0]]);
    assert_eq!(list(Some(DeliveryState::Failed), None, 9).await, [ids[1]], "a test is tried once");
    assert_eq!(list(Some(DeliveryState::Pending), None, 9).await, [ids[4], ids[3]]);
    bench.advance(KEEP_TIME - Duration::from_secs(1));
    bench.sweep().await;
    assert_eq!(list(None, None, 9).await.len(), 5);
    bench.advance(Duration::from_secs(1));
    bench.sweep().await;
    assert_eq!(list(None, None, 9).await, [], "also what was never sent");
}
