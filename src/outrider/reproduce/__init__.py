"""The results of the two papers beside ours: one file a part, one page for all."""
