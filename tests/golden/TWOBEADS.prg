1 ' Problem two_beads, strategy ladder
2 ' numpy 2.4, planner 1.0
3 ' 1 beads in 1 layers, 10.0 mm deposited, 1.8 s
4 ' Verified before it was written:
5 '   position_error: 0.0021 mm (limit 0.05)
6 '   reach: 0 mm (limit 0)
7 ' Output 1: doExtrude
8 ' J1 to J6, as Mitsubishi counts: joint_1, joint_2, joint_3, joint_4, joint_5, joint_6
9 ' Load: set it by Loadset before the first run
10 ' Calls 1 programs with 39 positions and 79 lines in all: import all of them
11 Tool (-44.510,9.900,113.950,0.0000,0.0000,0.0000)
12 Base P_NBase
13 Ovrd 100
14 M_Out(1)=0
15 JOvrd 49
16 Cnt 0
17 Mov J1
18 CallP "TWOBEADS_1"
19 M_Out(1)=0
20 End
J1=(30.0000,20.0000,120.0000,90.0000,-80.0000,60.0000)
