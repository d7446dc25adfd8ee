/* Seconds from a sample of the window to the next. */
static sf_real sf_seconds(const sf_flow *flow, uint32_t from)
{
    return (sf_real)(uint32_t)(flow->time_us[from + 1u] - flow->time_us[from]) * SF_R(1e-6);
}

