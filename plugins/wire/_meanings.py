"""What the members of the protocol's enumerations mean, in words; for its page."""

STATES = {
    "disarmed": "PWM off; nothing moves. Limits and nameplate can be written.",
    "holding": "PWM on (off after gates_off), holding the last operating point; zero current after arming.",
    "running": "A program runs.",
    "stopping": "The current is being ramped to zero.",
    "faulted": "In or on the way to the safe state; latched.",
}

FAULTS = {
    "none": "No fault.",
    "overcurrent": "A phase or the vector above the trip level.",
    "overload": "i²t above the limit of the motor or the drive.",
    "watchdog": "No heartbeat in time.",
    "bus_voltage": "DC bus too high or too low.",
    "overtemperature": "Motor or power stage too hot.",
    "program_too_long": "A program did not end when it should have.",
    "sensor": "A current or voltage reading is not plausible.",
    "limit": "Energy or duration of the experiment used up.",
    "emergency_stop": "EStop, or a switch on the drive.",
    "encoder": "The rotor turns where it must not, or its sensor fails.",
    "gate_driver": "The gate driver reports a fault.",
    "internal": "The firmware's own checks.",
    "interlock": "An interlock input opened while the power stage was on; fault_value has the bits of the open ones.",
}

OPS = {
    "identify": "Open a session; arg is the host's major version.",
    "arm": "Enable the power stage within the limits; the Ack's value is the session from here on.",
    "disarm": "PWM off. Done in any state; a fault stays latched.",
    "clear_fault": "Forget latched faults; the drive is disarmed afterwards.",
    "run_program": "Run the excitation in the registers; the Ack's value is the capture number.",
    "stop": "Give up the program, ramp the current to zero and hold zero; nothing to do where PWM is off.",
    "capture_arm": "Get ready to capture arg rows while holding; the Ack's value is the capture number.",
    "capture_trigger": "Start what capture_arm made ready.",
    "time_sync": "Send a Tick at once, taken when this command came in.",
    "parameter_write": "In an Ack: a refused ParameterWrite.",
    "parameter_read": "In an Ack: a ParameterRead of a register that is not there.",
    "read_block": "In an Ack: a refused ReadBlock; seq is its window.",
    "setpoint": "In an Ack: a refused Setpoint; seq is its seq.",
}

ACK_STATUSES = {
    "ok": "Done.",
    "wrong_state": "Not in this state of the power stage.",
    "past_limit": "Past the limits, or a limit past the drive's own.",
    "not_a_number": "NaN or infinite.",
    "out_of_range": "Outside the table's range, or registers that make no program.",
    "read_only": "The register is the drive's own.",
    "unknown": "No such command or register.",
    "not_supported": "Not among this drive's capabilities.",
    "stale_session": "Of a session that is not, or no longer, open.",
    "busy": "Another host has the drive armed.",
    "fault_latched": "clear_fault first.",
    "wrong_version": "Another major version.",
    "not_captured": "No such capture.",
    "overwritten": "The ring has gone over these rows.",
    "no_memory": "More rows than the memory holds.",
    "too_long": "A longer program than longest_program_s.",
    "interlock_open": "An interlock input forbids arming; the Ack's value has the bits of those that are open.",
}

PHASES = {
    "idle": "No program since arming.",
    "ramping": "On the way to the operating point.",
    "settling": "There; waiting, or injecting without capturing.",
    "capturing": "Rows are taken.",
    "complete": "The capture is complete; the operating point is held.",
    "given_up": "Stopped before its end; the rows so far can be read.",
}
