"""What every table goes through, alone: its schema, its values and keys, and its file, which is opened once."""
