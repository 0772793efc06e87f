"""Live view and view recording, both through Rerun.

    pipeline -> Timebase -> view items -+-> ViewPublisher -> child process -> viewer (native or web)
                                        '-> ViewRecorder  -> view.rrd, view.0001.rrd, ...

`items` defines what a view item is, `layout` which columns make which panel, `logger` turns items into Rerun
calls for the live stream and for the file alike.  Nothing here ever makes the caller wait: queues are
bounded and drop the oldest, and what was dropped is counted.
"""

RECORDER = "view recorder"
"""Name of the thread that writes view.rrd; at the end it may still be drawing."""
