"""Ports: open, read, watch, reconnect, list, detect.

`imumon.transport.port` opens one port and reads it; `imumon.transport.reader` keeps it open and reports what
becomes of it; `imumon.transport.detect` finds baud rate and protocol; `imumon.transport.ports` lists ports.
"""
