"""The experiments of the paper and further ones. They take tables and return tables; no file is opened here."""
