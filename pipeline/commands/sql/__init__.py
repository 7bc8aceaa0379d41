"""`lessbench sql`: one answer in the form that is asked for, or a prompt that answers one question after another."""
