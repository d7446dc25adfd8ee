# cython: language_level=3
"""The C of `templates/sf_flow.c` in doubles, with the methods of `sparsefit.onboard.board.Board`."""

from libc.stdint cimport uint32_t, uint64_t
from libc.string cimport memcpy

import numpy as np

from sparsefit.onboard.sweep import BoardAnswer, BoardDoubt


cdef extern from "sf_flow.h":
    ctypedef double sf_real
    ctypedef int sf_status
    ctypedef int sf_doubt
    ctypedef struct sf_config:
        sf_real response_time, drag_coefficient, thrust_x, thrust_y, thrust_scale
        sf_real lower, upper, precision, memory
        uint32_t any_heading, candidates
    ctypedef struct sf_answer:
        sf_status status
        sf_doubt doubt
        uint32_t samples
        sf_real mean_velocity, length_scale, timescale, heading
        sf_real mean_velocity_error, length_scale_error, timescale_error, heading_error
        sf_real innovation, correlation, unexplained, rival
        sf_real flow[8]
    ctypedef struct sf_flow:
        uint32_t samples, following
    sf_status sf_init(sf_flow *flow, const sf_config *config)
    sf_status sf_update(sf_flow *flow, uint64_t time_ns, const sf_real *position,
                        const sf_real *velocity, const sf_real *measured)
    sf_status sf_estimate(const sf_flow *flow, sf_answer *answer)


cdef class CompiledFlow:
    """The state of one estimator; it is its bytes, and can be pickled."""

    cdef sf_flow flow

    def __init__(self, settings):
        """Begin with `BoardSettings`."""
        cdef sf_config config = vars(settings)
        if sf_init(&self.flow, &config):
            raise ValueError("a setting of the board is out of its range")

    def update(self, uint64_t time_ns, double x, double y, double vx, double vy, measured=None):
        """Take a sample; the status of `sf_update`."""
        cdef sf_real position[2]
        cdef sf_real velocity[2]
        cdef sf_real push[2]
        position[0], position[1], velocity[0], velocity[1] = x, y, vx, vy
        if measured is None:
            return sf_update(&self.flow, time_ns, position, velocity, NULL)
        push[0], push[1] = measured
        return sf_update(&self.flow, time_ns, position, velocity, push)

    def estimate(self):
        """The answer from all samples so far, a `BoardAnswer`."""
        cdef sf_answer a
        sf_estimate(&self.flow, &a)
        value = np.array([a.mean_velocity, a.length_scale, a.timescale, a.heading])
        error = np.array([a.mean_velocity_error, a.length_scale_error, a.timescale_error, a.heading_error])
        tests = a.innovation, a.correlation, a.unexplained, a.rival
        return BoardAnswer(BoardDoubt(a.doubt), a.samples, value, error, *tests, np.array(a.flow))

    @property
    def following(self):
        """Whether the filters follow a flow."""
        return bool(self.flow.following)

    def __reduce__(self):
        return _restored, ((<char *>&self.flow)[: sizeof(sf_flow)],)


def _restored(content):
    cdef CompiledFlow board = CompiledFlow.__new__(CompiledFlow)
    if len(content) != sizeof(sf_flow):
        raise ValueError("a state of another version")
    memcpy(&board.flow, <char *>content, sizeof(sf_flow))
    return board
