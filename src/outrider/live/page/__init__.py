"""The page: what the tracker sees, for a browser on the handlebar; live, or from a finished run.

`server.PageSink` shows a live run, `replay.RunShow` a run folder. One binary message holds a picture
(`message`), the browser draws it (`static/`), and `guard` says who may look.
"""
