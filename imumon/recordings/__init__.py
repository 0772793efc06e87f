"""Sessions on disk: record, open, import, export."""
