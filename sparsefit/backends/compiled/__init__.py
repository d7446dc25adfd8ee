"""The loops compiled: extension modules, where they were built, made of the sources next door.

The .pxd files hold the C types of those sources; `dense` has the array functions in C.
"""
