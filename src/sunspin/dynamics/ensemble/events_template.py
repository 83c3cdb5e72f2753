# The events of one trajectory: a wheel comes to rest, is held by friction, breaks away. Scalar code on one row of numbers in
# body axes; text that is filled in and put into every generated kernel (compiled.py). It is not imported as it stands.
# ruff: noqa
# pyright: basic


@jit
def slow_step_one(w):
    pass  # STEP_ONE


@jit
def step_one(w):
    """The step DT of the row: the new state into its rows from NEW."""
    slow_step_one(w)
    pass  # ABOUT_NEW
    square = w[H] * w[H] + w[H + 1] * w[H + 1] + w[H + 2] * w[H + 2]
    if square > 0.0:
        size = math.sqrt(square)
        angle = w[SPIN] * size * w[DT]
        along = (
            (1.0 - math.cos(angle))
            * (w[H] * w[r] + w[H + 1] * w[r + 1] + w[H + 2] * w[r + 2])
            / square
        )
        spin_one(w, math.cos(angle), math.sin(angle) / size, along)


@jit
def spin_one(w, cosine, sine, along):
    pass  # SPIN_ONE


@jit
def observe_one(w):
    missed = 0
    pass  # OBSERVE_ONE
    return missed


@jit
def commit_one(w):
    for i in range(N_STATE):
        w[i] = w[NEW + i]


@jit
def set_modes(w, modes):
    """Load the numbers that depend on which wheels are free."""
    free = 0
    for i in range(N_WHEELS):
        if w[WHEEL + PER_WHEEL * i + FREE] > 0.5:
            free |= 1 << i
    for k in range(MODE_NUMBERS):
        w[SPIN + k] = modes[int(w[BODY]), free, k]


@jit
def stick(w, i):
    at = WHEEL + PER_WHEEL * i
    w[at + FREE] = 0.0
    w[at + COULOMB] = 0.0
    w[at + WATCH] = 0.0
    w[at + KEPT] = 0.0
    w[at + INVERSE_LIMIT2] = 1.0 / (w[at + DRY] * w[at + DRY])


@jit
def slip(w, i, sign):
    at = WHEEL + PER_WHEEL * i
    w[at + FREE] = 1.0
    w[at + COULOMB] = sign * w[at + DRY]
    w[at + WATCH] = sign
    w[at + INVERSE_LIMIT2] = 0.0


@jit
def rest_momentum(w, i, omega):
    """h of wheel i at rest on the body."""
    at = WHEEL + PER_WHEEL * i
    w[3 + i] = w[at + INERTIA] * (w[at] * omega[0] + w[at + 1] * omega[1] + w[at + 2] * omega[2])


@jit
def body_rate(w, omega):
    """omega at the committed state, from the parameters in force."""
    pass  # OMEGA_ONE


@jit
def wheel_speeds(w, omega, speeds):
    """The wheels' speeds at the committed state, which turns at omega."""
    pass  # SPEEDS_ONE


@jit
def release(w, i, omega, modes):
    """Let the stuck wheel i go, against the torque that held it when it was last observed."""
    body_rate(w, omega)
    rest_momentum(w, i, omega)
    slip(w, i, -1.0 if w[WHEEL + PER_WHEEL * i + TORQUE] > 0 else 1.0)
    set_modes(w, modes)


@jit
def settle(w, modes):
    """Release the stuck wheels that friction cannot hold, the most overloaded first."""
    omega = np.empty(3)
    for _ in range(N_WHEELS + 1):
        for i in range(N_STATE):
            w[NEW + i] = w[i]
        observe_one(w)
        worst, load = -1, 1.0
        for i in range(N_WHEELS):
            at = WHEEL + PER_WHEEL * i
            overload = w[at + TORQUE] * w[at + TORQUE] * w[at + INVERSE_LIMIT2]
            if overload > load:
                worst, load = i, overload
        if worst < 0:
            return
        release(w, worst, omega, modes)


@jit
def event_value(w, i, stuck):
    """Positive before the event of wheel i, negative after it."""
    at = WHEEL + PER_WHEEL * i
    if stuck:
        return 1.0 - w[at + TORQUE] * w[at + TORQUE] * w[at + INVERSE_LIMIT2]
    return w[at + WATCH] * w[at + SPEED]


@jit
def event_fraction(w, i, f_high):
    """Fraction of the step dt (in w) after which the event of wheel i happens: regula falsi, Illinois variant.

    f_high is the event's value after the whole step. A wheel that breaks away is returned on the far side of its event. One that has
    just begun to turn is at zero, give or take rounding, and on its way out: its event is the next zero.
    """
    at = WHEEL + PER_WHEEL * i
    stuck = w[at + INVERSE_LIMIT2] > 0.0
    dt = w[DT]
    if f_high > 0.0:
        return 2.0
    for k in range(N_STATE):
        w[NEW + k] = w[k]
    observe_one(w)
    low, high = 0.0, 1.0
    f_low = event_value(w, i, stuck)
    close = EVENT_TOLERANCE * (max(f_low, 0.0) - f_high)
    if stuck and f_low <= 0.0:
        return 0.0
    if f_low <= close:
        low = 1.0
        for _ in range(20):
            low *= 0.5
            w[DT] = low * dt
            step_one(w)
            observe_one(w)
            f_low = event_value(w, i, stuck)
            if f_low > close:
                break
            high, f_high = low, f_low
        w[DT] = dt
        if f_low <= close:
            return low
    for _ in range(60):
        middle = (low * f_high - high * f_low) / (f_high - f_low)
        if high - low < EVENT_TOLERANCE or f_high == 0.0:
            break
        w[DT] = middle * dt
        step_one(w)
        observe_one(w)
        f = event_value(w, i, stuck)
        if abs(f) < close and (f <= 0.0 or not stuck):
            high = middle
            break
        if f > 0.0:
            low, f_low, f_high = middle, f, f_high * 0.5
        else:
            high, f_high, f_low = middle, f, f_low * 0.5
    w[DT] = dt
    return high


@jit
def through_events(w, modes):
    """Redo the step of one lane through the wheel events inside it; returns its outcome."""
    left = w[DT]
    omega = np.empty(3)
    after = np.empty(N_WHEELS)
    for _ in range(MAX_EVENTS_PER_STEP):
        w[DT] = left
        step_one(w)
        if observe_one(w) == 0:
            return FINE
        first, fraction = -1, 2.0
        for i in range(N_WHEELS):
            after[i] = event_value(w, i, w[WHEEL + PER_WHEEL * i + INVERSE_LIMIT2] > 0.0)
        for i in range(N_WHEELS):
            at = WHEEL + PER_WHEEL * i
            if w[at + WATCH] != 0.0 or w[at + INVERSE_LIMIT2] > 0.0:
                w[DT] = left
                theta = event_fraction(w, i, after[i])
                if theta < fraction:
                    first, fraction = i, theta
        if first < 0:
            w[DT] = left
            step_one(w)
            observe_one(w)
            return FINE
        w[DT] = fraction * left
        step_one(w)
        commit_one(w)
        before = left
        left -= fraction * left
        if before < 0.0:
            # backward in time a turning wheel meets zero only where it reversed: what can hold it never let it start
            slip(w, first, -w[WHEEL + PER_WHEEL * first + WATCH])
            continue
        if w[WHEEL + PER_WHEEL * first + INVERSE_LIMIT2] > 0.0:
            observe_one(w)
            release(w, first, omega, modes)
        else:
            body_rate(w, omega)
            rest_momentum(w, first, omega)
            stick(w, first)
            set_modes(w, modes)
        settle(w, modes)
    return CHATTERS


@jit
def give_up(w):
    """Stop watching the wheels of a lane that failed, so that it costs no more; its outcome says why."""
    for i in range(N_WHEELS):
        w[WHEEL + PER_WHEEL * i + WATCH] = 0.0
        w[WHEEL + PER_WHEEL * i + INVERSE_LIMIT2] = 0.0
