"""What a person types that is no stage: check, new_task, recover, run, serve, sql, study, verify, watch."""
