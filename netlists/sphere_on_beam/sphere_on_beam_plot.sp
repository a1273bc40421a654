*ng_script
* Run it with:  ngspice sphere_on_beam_plot.sp
source sphere_on_beam.cir
run
plot v(beam_middle) v(sphere_y) ylabel 'um' title 'sphere_on_beam'
plot @b.xcontact.bmiddle[i] ylabel 'N' title 'sphere_on_beam'
plot v(contact_v) ylabel 'm/s' title 'sphere_on_beam'
