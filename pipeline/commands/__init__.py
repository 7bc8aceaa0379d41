"""What a person types that is no stage of the graph: check, new_task, recover, run, serve, sql, study, verify, watch."""
