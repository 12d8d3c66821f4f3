//! The rules of the job store, tried on every engine. `jobs_store/rules*.rs` holds the rules; an engine is a bench of its
//! own in `jobs_store/engines.rs` and one line below.

#[path = "jobs_store/batches.rs"]
mod batches;
#[path = "jobs_store/encrypted.rs"]
mod encrypted;
#[path = "jobs_store/engines.rs"]
pub mod engines;
#[path = "jobs_store/keeping.rs"]
mod keeping;
#[path = "jobs_store/many.rs"]
mod many;
#[path = "jobs_store/resumable.rs"]
mod resumable;
#[path = "jobs_store/sqlite_file.rs"]
mod sqlite_file;
#[path = "jobs_store/taking.rs"]
mod taking;
#[path = "jobs_store/telling.rs"]
mod telling;
#[path = "jobs_store/webhooks.rs"]
mod webhooks;

/// Every rule as a test of `$engine`.
macro_rules! rules {
    ($engine:ident: $($room:ident { $($rule:ident)* })*) => {
        mod $engine {
            $($(
                #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
                async fn $rule() {
                    super::$room::$rule(&super::engines::$engine().await).await;
                }
            )*)*
        }
    };
}

macro_rules! all_rules_on {
    ($engine:ident) => {
        rules! { $engine:
            taking {
                a_job_is_taken_by_one_worker
                a_late_result_is_refused_by_its_attempt
                a_lease_lasts_while_its_worker_is_heard_of
                a_lost_worker_costs_one_repeat_and_the_second_one_the_job
                a_job_given_back_is_nobodys_loss
                all_jobs_of_a_dead_process_wait_again_at_once
                urgent_jobs_go_first_and_callers_take_turns
                a_large_job_lets_small_ones_pass_but_not_for_ever
                two_processes_share_the_work_without_doing_it_twice
                stepping_the_clock_breaks_no_rule
            }
            keeping {
                canceling_ends_a_waiting_job_and_asks_a_running_one
                a_deadline_ends_a_waiting_job
                final_states_never_change
                results_end_by_time_and_their_files_are_collected
                what_gives_nothing_keeps_nothing
                the_oldest_results_and_assets_go_first
                old_records_and_surplus_ones_are_forgotten
                equal_files_of_a_caller_are_one_asset
            }
            telling {
                an_equal_job_succeeds_at_once_with_the_earlier_result
                an_idempotency_key_stands_for_one_request_for_a_day
                a_callers_own_id_stands_for_one_job
                answers_to_other_requests_are_given_again
                no_more_jobs_wait_than_may
                events_have_numbers_without_gaps_and_end_with_done
                progress_never_falls
                lists_are_newest_first_filtered_and_each_callers_own
            }
            batches {
                a_batch_is_written_in_order_and_each_item_settled_once
                a_batch_is_over_when_its_items_are
                canceling_a_batch_ends_what_waits_and_names_what_runs
                an_asset_that_an_item_waits_for_is_kept
                batches_are_each_callers_own_and_forgotten_in_time
            }
            resumable {
                an_upload_grows_at_its_end_alone
                the_last_bytes_make_an_asset_of_an_upload_once
                uploads_that_nobody_goes_on_with_expire_and_are_remembered
            }
            webhooks {
                what_happens_is_told_to_whoever_wants_it_and_to_nobody_else
                work_that_begins_anew_is_not_told_again
                a_message_tells_of_the_rig_as_it_was_then
                the_end_of_a_batch_is_told_once
                a_message_is_sent_by_one_and_by_another_when_that_one_is_lost
                two_senders_never_send_the_same_message_at_once
                a_message_is_tried_by_the_schedule_and_then_given_up
                an_endpoint_that_is_overloaded_is_left_alone
                an_endpoint_that_is_gone_is_disabled_until_its_caller_enables_it
                a_failing_endpoint_gets_one_message_at_a_time_and_holds_up_no_other
                two_secrets_sign_for_a_day_after_one_is_replaced
                endpoints_are_each_callers_own_bounded_and_forgotten_whole
                what_one_job_wants_told_goes_where_it_says_and_is_a_matter_of_that_message_alone
                deliveries_are_listed_by_state_and_forgotten_in_time
            }
        }
    };
}

all_rules_on!(sqlite);
all_rules_on!(postgres);
