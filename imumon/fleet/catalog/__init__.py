"""What is known of sessions and units: a folder of sessions as tables, and the record of one as a page."""
