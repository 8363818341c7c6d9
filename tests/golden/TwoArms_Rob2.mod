MODULE TwoArms_Rob2
    ! Problem two_arms: task T_ROB2 with ROB_2, ABB IRB 1200-5/0.9, which moves the part
    ! MultiMove: TwoArms.mod in task T_ROB1 and TwoArms_Rob2.mod in T_ROB2 run at the
    ! same time: load both, set both program pointers to main, start both. Neither runs without the other.

    ! The load below is a placeholder: identify what the flange carries before the first run.
    PERS tooldata bwFlange:=[TRUE,[[0.000,0.000,0.000],[1.0000000,0.0000000,0.0000000,0.0000000]],[1,[0,0,50],[1,0,0,0],0,0,0]];
    PERS tasks bwTasks{2}:=[["T_ROB1"],["T_ROB2"]];
    VAR syncident bwPlaced;
    VAR syncident bwTogether;
    VAR syncident bwApart;

    CONST speeddata vel100:=[100,100,1000,100];

    PROC main()
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,0.00000],[9E9,9E9,9E9,9E9,9E9,9E9]],vel100,fine,bwFlange;
        WaitSyncTask bwPlaced,bwTasks;
        SyncMoveOn bwTogether,bwTasks;
        Start;
        Bead0001;
        Finish;
        SyncMoveOff bwApart;
    UNDO
        SyncMoveUndo;
    ENDPROC

    PROC Start()
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,0.00000],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=1,vel100,fine,bwFlange;
    ENDPROC

    PROC Bead0001()
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,0.39773],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=2,vel100,z10,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,0.84858],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=3,vel100,z10,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,1.48401],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=4,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,2.68144],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=5,vel100,z10,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,3.20809],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=6,vel100,z10,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,3.64685],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=7,vel100,z10,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,4.09583],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=8,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,4.54996],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=9,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,5.00409],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=10,vel100,z1,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,5.45307],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=11,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,5.89183],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=12,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,6.41848],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=13,vel100,z1,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,7.92022],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=14,vel100,z10,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,8.36782],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=15,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,8.74069],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=16,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,9.03590],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=17,vel100,z1,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,9.09989],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=18,vel100,fine,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,6.00077],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=19,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,1.95636],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=20,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-2.08805],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=21,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-5.97068],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=22,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-9.09992],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=23,vel100,fine,bwFlange;
    ENDPROC

    PROC Finish()
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-8.81092],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=24,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-8.47500],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=25,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-8.05941],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=26,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-7.45136],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=27,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-6.41848],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=28,vel100,z1,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-5.89183],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=29,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-5.45307],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=30,vel100,z1,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-5.00409],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=31,vel100,z1,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-4.54996],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=32,vel100,z1,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-4.09583],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=33,vel100,z10,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-3.64685],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=34,vel100,z10,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-3.10057],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=35,vel100,z10,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-2.47942],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=36,vel100,z10,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-1.17970],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=37,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-0.62492],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=38,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,-0.20020],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=39,vel100,z5,bwFlange;
        MoveAbsJ [[0.00000,60.00000,-40.00000,0.00000,-110.00000,0.00000],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=40,vel100,fine,bwFlange;
    ENDPROC

ENDMODULE
