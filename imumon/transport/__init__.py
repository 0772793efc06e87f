"""Ports: open, read, watch, reconnect, list, detect.

`imumon.transport.port` opens one port and reads it; `imumon.transport.reader` keeps it open and says what
becomes of it; `imumon.transport.detect` finds baud rate and protocol; `imumon.transport.ports` lists ports.
"""
