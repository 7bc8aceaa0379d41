"""The experiments of the paper and ours: tables in, tables out; no file is opened here."""
