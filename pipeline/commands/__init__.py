"""What is no stage: check, new_task, recover, remove_task, run, serve, sql, study, verify, watch."""
