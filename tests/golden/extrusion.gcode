; two_beads: extrusion in time with the robot, strategy ladder
; 2 beads in 1 layers, 4.989 mm of filament, 3.456 s from the robot's first motion
; it waits for the robot at both ends of each bead: doExtrude to input 1 (J of M950)
; start it first, then the robot's program
M203 I0.6
M595 R0
M83
T0
M577 P1 S1
; bead 0, layer 0
G1 E0.08795 F329.812
G1 E0.99770 F299.310
G1 E0.09008 F270.240
G1 E0.05034 F151.020
G1 E0.03124 F93.720
G1 E0.04012 F120.360
G1 E0.07838 F235.140
G1 E0.09906 F297.180
G1 E0.96966 F299.895
M400
while sensors.gpIn[1].value == 1 && iterations < 10
  G1 E0.04998 F299.880
  M400
M577 P1 S0
M577 P1 S1
; bead 1, layer 0
G1 E0.08795 F329.812
G1 E0.99770 F299.310
G1 E0.09008 F270.240
G1 E0.05034 F151.020
G1 E0.03124 F93.720
G1 E0.04012 F120.360
G1 E0.07838 F235.140
G1 E0.09906 F297.180
G1 E0.96966 F299.895
M400
while sensors.gpIn[1].value == 1 && iterations < 10
  G1 E0.04998 F299.880
  M400
M577 P1 S0
G4 P744
