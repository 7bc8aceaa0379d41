"""Commands that are not stages: check, new_task, recover, remove_task, run, serve, sql, study, verify, watch."""
