; two_beads: extrusion in time with the robot, strategy ladder
; 2 beads in 1 layers, 8.435 mm of filament, 7.056 s from the robot's first motion
; it waits for the robot at both ends of each bead: doExtrude to input 1, doSupport to input 2 (J of M950)
; start it first, then the robot's program
M203 I0.6
M595 R0
M83
; heat
M104 T1 S195
M104 T0 S190
; select pla
T1
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
G4 P744
; change to pva, bead 1
T0
G4 P2000
; purge, bead 1
G1 E5.00000 F300.000
M577 P2 S1
; bead 1, layer 0
G1 E0.03316 F124.350
G1 E0.37617 F112.851
G1 E0.03397 F101.910
G1 E0.01898 F56.940
G1 E0.01178 F35.340
G1 E0.01512 F45.360
G1 E0.02955 F88.650
G1 E0.03736 F112.080
G1 E0.36559 F113.069
M400
while sensors.gpIn[2].value == 1 && iterations < 10
  G1 E0.01885 F113.100
  M400
M577 P2 S0
G4 P744
