"""Names of the package that tests use: the only place in the tests that knows its layout.

Tests import ``from support import NAME``. A module is loaded when its first name is needed. A name
that several modules use for different objects has an alias here, as ``NAME=ALIAS``.
"""

from importlib import import_module

NAMES_BY_MODULE = {
    "kc2spice.core.curve_distance": "compute_curve_distance",
    "kc2spice": "api pyspice",
    "kc2spice.bodies.contact_pressure": (
        "PressureBasis TransverselyIsotropicSphere choose_pressure_basis "
        "compute_local_compliance compute_sphere_compliance compute_stresses_under_force "
        "compute_surface_compliance fit_indentation_law make_sphere_model solve_contact_forces"
    ),
    "kc2spice.bodies.enriched_model": "correct_responses enrich_model solve_definite",
    "kc2spice.bodies.face_motion": "FaceMotion sample_face_motion",
    "kc2spice.bodies.fields": (
        "FieldProbe compute_largest_principal_stress compute_lowest_modes evaluate_at_nodes "
        "find_extremes recover_motion recover_vibration write_vtu"
    ),
    "kc2spice.bodies.heat_field": "recover_temperatures write_temperatures",
    "kc2spice.bodies.heat_model": "HeatBoundaryConditions make_heat_model",
    "kc2spice.bodies.impedance": "analyse_impedance",
    "kc2spice.bodies.readers": "measure_mesh_extent read_model sidecar",
    "kc2spice.bodies.readers.column_titles": "read_title",
    "kc2spice.bodies.readers.measured_admittance": (
        "MeasuredAdmittance is_measured parse_shunt_resistance read_measured"
    ),
    "kc2spice.bodies.readers.sidecar": "read_sidecar",
    "kc2spice.bodies.readers.thermal_transient": "is_transient read_transient",
    "kc2spice.bodies.solid_models": (
        "Block BondedBlocks BoundaryConditions PortLoad list_outer_faces make_damped_model "
        "spread_force"
    ),
    "kc2spice.bodies.stack": "choose_level_spans make_stack make_stack_setup",
    "kc2spice.bodies.stack_keys": "Cap StackKeys StackMeshKeys",
    "kc2spice.bodies.undamped_models": "compute_undamped_responses",
    "kc2spice.cli": "doctor",
    "kc2spice.cli.doctor": "_PYTHON_PACKAGES InstallationFinding",
    "kc2spice.cli.doctor_output": "print_findings",
    "kc2spice.cli.main": "EXAMPLES app",
    "kc2spice.cli.part_type_output": "print_keys",
    "kc2spice.cli.terminal_output": "OutputRecipient print_result",
    "kc2spice.core": "cache constitutive_laws=laws install_commands progress quantities",
    "kc2spice.core.argument_and_option_names": (
        "replace_options_by_arguments replace_arguments_by_options"
    ),
    "kc2spice.core.attribute_advice": "AdvisesOnAttributes",
    "kc2spice.core.cache": "load_or_build",
    "kc2spice.core.domains": (
        "CONSERVATIVE DOMAINS PORTS QUANTITIES SPICE_UNITS TABLE find_across_quantity find_domain"
    ),
    "kc2spice.core.equality": "have_same_content",
    "kc2spice.core.error_norms": "NORM_WORDS PEAK_SHARE",
    "kc2spice.core.errors": (
        "GateMissedError Kc2spiceError MissingToolError SimulationError UsageError did_you_mean"
    ),
    "kc2spice.core.figure": "ColourMap Curve Figure Panel",
    "kc2spice.core.files": "stage_directory",
    "kc2spice.core.key_errors": "validate_table",
    "kc2spice.core.magnets": (
        "MagnetostaticTable TEST_CURRENTS compute_current_products compute_test_forces"
    ),
    "kc2spice.core.memory": "find_available_bytes",
    "kc2spice.core.memory_store": "Workspace",
    "kc2spice.core.mesh_error_descriptions": "MESH_ERROR_PREFIX MESH_QUANTITIES list_mesh_errors",
    "kc2spice.core.optional_libraries": "OPTIONAL_LIBRARIES import_optional",
    "kc2spice.core.other_file_formats": "CAD MESH=MESH_FORMAT SURFACE identify_format",
    "kc2spice.core.plugins": "list_entry_points load_plugin",
    "kc2spice.core.probe_values": "compute_mean_frequency",
    "kc2spice.core.progress": (
        "ConvergenceTimer ERROR_BUDGET StageTimer StepTimer follow_stage ignore_progress"
    ),
    "kc2spice.core.quantities": (
        "BOLTZMANN DEFAULT_TEMPERATURE Ratio RefinementRule Section convert_quantity"
    ),
    "kc2spice.core.schemas": "find_section get_plausible_range",
    "kc2spice.core.si_prefix_format": (
        "format_percent format_quantity format_value_and_limit remove_unit_words"
    ),
    "kc2spice.core.sound_level": "SoundLevel",
    "kc2spice.core.spectrum": "find_energy_frequency find_waveform_frequency",
    "kc2spice.core.toml_text": "format_toml",
    "kc2spice.core.units": "parse_unit",
    "kc2spice.core.user_warnings": "collect_warnings",
    "kc2spice.core.untrusted_files": (
        "MAX_TEXT_BYTES call_in_child explain_unsafe_name make_plain_name parse_toml read_bounded"
    ),
    "kc2spice.core.waveforms": (
        "PulseKeys RecordedWave Waveforms differentiate make_constant_waveform "
        "make_linear_waveform make_pulse_waveform make_sine_waveform"
    ),
    "kc2spice.equations.recorded_sources": "find_replayed_nets",
    "kc2spice.equations.scene_laws": "SceneLaws get_scene_laws store_laws",
    "kc2spice.fem": "magnet_field materials",
    "kc2spice.fem.body_keys": "DampingKeys",
    "kc2spice.fem.element_poling": "find_coarse_elements",
    "kc2spice.fem.enrichment": "assemble_enrichment evaluate_shape_functions make_enrichment",
    "kc2spice.fem.field_recovery": "compute_energy_products",
    "kc2spice.fem.heat_conduction": (
        "HeatSolid assemble_faces assemble_heat duplicate_face_nodes "
        "evaluate_functions_at_point find_common_faces find_face_nodes"
    ),
    "kc2spice.fem.magnet_field": (
        "LOWER SPHERE choose_compared_height_count compute_magnetostatic_table make_field_assembler"
    ),
    "kc2spice.fem.magnet_keys": "CatchKeys RingKeys",
    "kc2spice.fem.magnet_rings": (
        "LoopModel Winding _fit_power_series compare_loops_with_rings divide_section "
        "make_current_loop reduce_to_loops"
    ),
    "kc2spice.fem.materials": "Material find_material",
    "kc2spice.fem.mesh_cells": "CellBlock make_quadratic_mesh reject_folded_elements",
    "kc2spice.fem.mesh_file": "FILE_FORMATS SURFACE_SUFFIXES measure_extent read_mesh",
    "kc2spice.fem.solid": "Solid assemble_solid compute_node_shares find_mesh_frequency_limit",
    "kc2spice.fem.thermal_materials": (
        "find_resistance_coefficient find_thermal_material load_thermal_library"
    ),
    "kc2spice.linalg": "factor openblas_kernels pardiso",
    "kc2spice.linalg.factor": "factorise_quasi_definite",
    "kc2spice.linalg.quasidefinite": "QuasiDefiniteFactor find_supernodes",
    "kc2spice.netlist": "deck",
    "kc2spice.netlist.card_parser": "read_cards",
    "kc2spice.netlist.circuit": "Circuit Element Param Pin make_positive_parameter",
    "kc2spice.netlist.deck": "AnalysisCommand Deck make_ac_command",
    "kc2spice.netlist.deck_translation": "translate_deck write_dialect_files write_symbol_files",
    "kc2spice.netlist.edited_deck": "normalise_element read_edited_deck",
    "kc2spice.netlist.expression": (
        "BinaryOperation ConditionalExpression ExpressionWriter Number UnaryOperation "
        "evaluate_parameter parse_expression parse_literal"
    ),
    "kc2spice.netlist.importer": "translate_circuit",
    "kc2spice.netlist.include_scan": "read_checked_circuit read_included_netlist",
    "kc2spice.netlist.lint": "find_wiring_mistakes require_valid_wiring",
    "kc2spice.netlist.nodal": "NodalCircuit",
    "kc2spice.netlist.scale_factors": (
        "format_with_prefix read_parameter read_user_number read_value write_numbers_with_prefixes"
    ),
    "kc2spice.netlist.printers": "dialect_registry",
    "kc2spice.netlist.printers.dialect_registry": (
        "find_dialect list_deck_dialects list_dialect_names"
    ),
    "kc2spice.netlist.printers.line_breaks": "wrap_card wrap_comments",
    "kc2spice.netlist.printers.ngspice": "Printer",
    "kc2spice.netlist.printers.plot_script": "format_plot_script",
    "kc2spice.netlist.printers.verilog_a": "format_module",
    "kc2spice.netlist.subcircuit_library": (
        "Header ReductionSummary Subcircuit join_comments parse_subcircuits read_lib"
    ),
    "kc2spice.netlist.transforms": "make_array_deck with_parameters",
    "kc2spice.parts.acoustics._acoustic_load": "collect_load",
    "kc2spice.parts.acoustics._radiation_impedance": "RADIATORS",
    "kc2spice.parts.bodies": "_body_model _neglected_effects bimorph disc langevin",
    "kc2spice.parts.bodies._body_figures": "OBLIQUE_SHIFT draw_deformed_body draw_modes",
    "kc2spice.parts.bodies._body_model": "describe_reduction_target find_scene_band",
    "kc2spice.parts.bodies._body_ports": "list_inertial_pins",
    "kc2spice.parts.bodies._face_sound_levels": "find_nodal_circle_diameter",
    "kc2spice.parts.bodies._heat_keys": "HeatBodyKeys",
    "kc2spice.parts.bodies._linear_body": "LinearBody",
    "kc2spice.parts.bodies._varied_keys": "list_varied_keys read_number_key with_values",
    "kc2spice.parts.bodies.bimorph": "BimorphKeys make_bimorph_blocks",
    "kc2spice.parts.bodies.body": "BodyKeys build_fe_model",
    "kc2spice.parts.bodies.heat_body": "assemble_heat_model",
    "kc2spice.parts.control.pid": "PidKeys make_pid_subcircuit",
    "kc2spice.parts.electronics._parts_with_netlist_template": (
        "CoilLoad make_key_parameters make_opamp_subcircuit"
    ),
    "kc2spice.parts.electronics.driver_types": (
        "Amplifier AmplifierKeys ChargeDrive ChargeDriveKeys HalfBridge HalfBridgeKeys "
        "LinearDrive LinearDriverKeys PwmDrive PwmKeys"
    ),
    "kc2spice.parts.electronics.two_terminal_types": "TABLE=TWO_TERMINAL_TABLE make_element_law",
    "kc2spice.parts.electrostatics.gap": "count_film_branches",
    "kc2spice.parts.magnetics": "moving_conductor ring_magnet_coils",
    "kc2spice.parts.magnetics.moving_conductor": "MAX_RING_ERROR declare_moving_body",
    "kc2spice.parts.magnetics.moving_magnet": "compute_demagnetising_factor",
    "kc2spice.parts.magnetics.ring_magnet_coils": "make_coils_subcircuit",
    "kc2spice.parts.mechanics": "mass",
    "kc2spice.parts.mechanics._contact_surfaces": "ContactPair compute_ring_gaps find_separation",
    "kc2spice.parts.mechanics.mass": "declare_point_mass",
    "kc2spice.parts.mechanics.sphere": "SphereKeys compute_settling_time declare_sphere",
    "kc2spice.physics": "DeclaredPart branch coils contact law",
    "kc2spice.physics.contact": "ContactForce SPACING_NOTE declare_contact",
    "kc2spice.physics.declaration": "COORDINATES Declaration current displacement measured voltage",
    "kc2spice.physics.declaration_cards": "write_subcircuit_items",
    "kc2spice.physics.junction": "Junction",
    "kc2spice.physics.law": "DeclaredLaw",
    "kc2spice.physics.lookup_tables": "TableFunction",
    "kc2spice.physics.part": "make_declared_subcircuit",
    "kc2spice.physics.symbolic_algebra": "evaluate_tree multiply_trees",
    "kc2spice.pyspice": "pyspice_subcircuit",
    "kc2spice.reference.equilibrium": "solve_operating_point",
    "kc2spice.reference.fixed_step_integrator": "integrate_steps",
    "kc2spice.reference.radau_integrator": "Trajectory solve_transient",
    "kc2spice.reference.small_signal_analysis": "LinearisedSystem solve_ac",
    "kc2spice.reference.system": "assemble_system",
    "kc2spice.report.charts": "render_figure",
    "kc2spice.report.drawings": "write_side_view_caption",
    "kc2spice.report.matplotlib_figures": "write_pngs",
    "kc2spice.report.html": "PageSection write_page",
    "kc2spice.report.probe_figure": "plot_probes",
    "kc2spice.report.run_page": (
        "format_model_summary format_operating_point format_results format_summary write_run"
    ),
    "kc2spice.report.sweep_page": "_plot_histogram compute_yields",
    "kc2spice.report.verify_page": "VerificationResult format_verification",
    "kc2spice.rom": "pencil stability",
    "kc2spice.rom.band": "choose_natural_band compute_elastic_eigenvalues find_band_end",
    "kc2spice.rom.branch_fit": "fit_one_port",
    "kc2spice.rom.certification": "certify",
    "kc2spice.rom.complex_material_constants": "ComplexConstants make_complex_constants_model",
    "kc2spice.rom.constraints": (
        "compute_null_basis deflate_infinite_poles eliminate_algebraic_unknowns"
    ),
    "kc2spice.rom.decoupled_blocks": "decouple_states make_block_model",
    "kc2spice.rom.error_estimate": "compute_relative_error",
    "kc2spice.rom.free_body": "split_free_body",
    "kc2spice.rom.heat_network": "FosterNetwork HeatLadder find_heat_ladder",
    "kc2spice.rom.instability": "explain_instability",
    "kc2spice.rom.intermediate_reduction": "build_intermediate_model",
    "kc2spice.rom.io": "read_rom write_rom",
    "kc2spice.rom.linear_model": "Certificate LinearModel Port make_piezoelectric_model",
    "kc2spice.rom.lossy_modes": (
        "assemble_oscillators fit_relaxing_oscillator make_viscous_oscillator"
    ),
    "kc2spice.rom.modal_models": (
        "Resonators add_dielectric_loss compute_resonators fit_foster_network "
        "make_highest_modes_massless simulate_resonators tabulate_modes"
    ),
    "kc2spice.rom.multiport": "fit_multiport",
    "kc2spice.rom.one_port_network": "CircuitBranch ParallelBranches recognise_parallel_branches",
    "kc2spice.rom.parametric_model_files": "read_parametric_model",
    "kc2spice.rom.parametric_models": (
        "ParameterAxis compute_modal_transfer evaluate_polynomials reduce_over_parameters"
    ),
    "kc2spice.rom.pencil": "Pencil SchurComplement apply_congruence eliminate_massless",
    "kc2spice.rom.range_reduction": "RangeTask",
    "kc2spice.rom.reduce": "reduce_model",
    "kc2spice.rom.reduced_basis": "ReductionTask",
    "kc2spice.rom.reductors": "balanced_truncation band_limited_balancing registry",
    "kc2spice.rom.reductors.balanced_truncation": "BalancedTruncation _compute_gramian_root",
    "kc2spice.rom.reductors.block_krylov": "BlockKrylov",
    "kc2spice.rom.reductors.rational_krylov": "RationalKrylov",
    "kc2spice.rom.reductors.response_pod": "ResponsePod",
    "kc2spice.rom.resonators_over_ranges": "ResonatorsOverRanges reduce_over_ranges",
    "kc2spice.rom.response": "Response",
    "kc2spice.rom.soft_support": "support_softly",
    "kc2spice.rom.stability": "prove_stability",
    "kc2spice.rom.structural_damping": (
        "add_structural_damping compute_causal_stiffness_factor fit_relaxing_stiffness"
    ),
    "kc2spice.rom.full_model_surrogate": "make_surrogate",
    "kc2spice.rom.time_domain_errors": (
        "ReductionsByOrder compute_time_errors compute_time_response find_last_change"
    ),
    "kc2spice.rom.transient_fit": "StepSamples fit_transient",
    "kc2spice.scene": "noise_analysis part_method_calls=resolve parttype",
    "kc2spice.scene.catalogue": "find_part read_catalogue search_parts",
    "kc2spice.scene.checks": "Check Gate RunEnergyBalance Verdict require_passed",
    "kc2spice.scene.highest_frequency": "find_highest_frequency",
    "kc2spice.scene.keys": "KeyDescription list_all_keys list_part_keys list_schema_keys",
    "kc2spice.scene.load": "_make_scene load_scene",
    "kc2spice.scene.metrics": "Metrics compute_metrics",
    "kc2spice.scene.scene_classes": (
        "BuiltScene DeclaredScene GovernedScene JoinedScene PartType WiredScene "
        "compute_scene_hash find_flows"
    ),
    "kc2spice.scene.net_formation": "describe_nets",
    "kc2spice.scene.numerical_settings": "describe_analysis describe_plan find_numerical_settings",
    "kc2spice.scene.part_records": "NeglectedEffect SampledSource",
    "kc2spice.scene.part_type_descriptions": "describe_part_types",
    "kc2spice.scene.parttype": "compute_pin_forces find_part_type list_type_names load_part_types",
    "kc2spice.scene.part_method_calls": "add_results_and_sources name_subcircuits",
    "kc2spice.scene.results": "NOISE_WAVE",
    "kc2spice.scene.scene_file": "SceneFile list_gallery",
    "kc2spice.scene.settings": "ProbeKeys RomKeys",
    "kc2spice.sim": "ngspice",
    "kc2spice.sim.libngspice": "run_in_libngspice",
    "kc2spice.sim.ngspice": "RetriesFailedError find_ngspice run_deck run_with_retries write_files",
    "kc2spice.sim.output": "find_failure list_changed_cards read_raw",
    "kc2spice.synthesis": "parameter_ranges ringing_time terminals",
    "kc2spice.synthesis.circuit_error": "estimate_circuit_error require_circuit_tolerance",
    "kc2spice.synthesis.library_headers": "write_part_header write_rom_comments",
    "kc2spice.synthesis.parametric_resonators": "parametric_subcircuit",
    "kc2spice.synthesis.model_to_subcircuit": "subcircuit",
    "kc2spice.workflow": (
        "bench body_fit circuit_fit decks reduction_of_models_from_files=reduce_files "
        "settings_refinement simulation"
    ),
    "kc2spice.workflow.decks": "make_deck prepare_deck",
    "kc2spice.workflow.export": "export_scene",
    "kc2spice.workflow.fit_keys": "format_calibrated_ranges",
    "kc2spice.workflow.larger_reduced_model_orders": "suggest_keys",
    "kc2spice.workflow.method_comparison": "compare_methods",
    "kc2spice.workflow.misfit": "compute_rms_misfit estimate_covariance find_likely_cause",
    "kc2spice.workflow.part_models": "build_models find_value_units list_model_values",
    "kc2spice.workflow.reduction_of_models_from_files": (
        "_load_scene_body export_rom make_example_deck reduce_file"
    ),
    "kc2spice.workflow.settings_refinement": "repeat_timing",
    "kc2spice.workflow.run": "complete_run run_scene",
    "kc2spice.workflow.simulation": "run_simulation simulate_deck",
    "kc2spice.workflow.sweep": "sweep_execution",
    "kc2spice.workflow.sweep.grid": "make_plan",
    "kc2spice.workflow.sweep.point": "PointResult SceneInput read_scene_text",
    "kc2spice.workflow.sweep.row_store": "RowStore collect_columns write_csv",
    "kc2spice.workflow.sweep.sweep_execution": "load_named_sweep make_sweep",
    "kc2spice.workflow.sweep.workers": "make_dask_connector make_local_pool_opener",
    "kc2spice.workflow.time_step": "choose_largest_step",
    "kc2spice.workflow.verdict": "add_undecided_warnings form_verdict",
    "kc2spice.workflow.verify": "body_verification",
    "kc2spice.workflow.verify.body_verification": "compare_responses",
    "kc2spice.workflow.verify.differences": (
        "Solution compute_gate_difference compute_output_errors list_gate_checks list_metric_errors"
    ),
    "kc2spice.workflow.verify.full_models": "solve_full_models",
    "kc2spice.workflow.verify.full_transient": "FullModelDifference find_last_rest",
    "kc2spice.workflow.verify.law_solution": "solve_laws",
    "kc2spice.workflow.verify.scene_verification": "verify_scenes",
}


def _list_homes():
    """Yield the name in tests, the module, and the name in the module."""
    for module, names in NAMES_BY_MODULE.items():
        for name in names.split():
            original, _, alias = name.partition("=")
            yield alias or original, module, original


HOMES = {name: (module, original) for name, module, original in _list_homes()}


def __getattr__(name):
    if name not in HOMES:
        raise AttributeError(name)
    module, original = HOMES[name]
    home = import_module(module)
    if hasattr(home, original):
        return getattr(home, original)
    return import_module(f"{module}.{original}")
