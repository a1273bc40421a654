"""Short names: tables that need no ``part`` key, and the type that each means."""

SHORT = {
    "kick": "piezo_stack",
    "contact": "contact",
    "sphere": "sphere",
    "catch": "ring_magnet_coils",
    "control": "pid",
    "impact": "throw",
    "imprint": "push",
    "harmonic": "port_loads",
    "em_force": "current_cases",
}
