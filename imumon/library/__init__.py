"""imumon as a library: live samples of a port, recordings as tables, stages of one's own.

Everything here is what the command line is made of; the names that `import imumon` offers stay.
"""
