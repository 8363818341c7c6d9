MODULE AskedBead
    ! Problem asked_bead, strategy ladder
    ! numpy 2.4, planner 1.0
    ! 1 beads in 1 layers, 12.0 mm deposited, 1.8 s
    ! Verified before it was written:
    !   position_error: 0.0021 mm (limit 0.05)
    !   reach: 0 mm (limit 0)
    ! 16 moves, 9 of them along beads, whose toolpath has 12 waypoints

    ! The load below is a placeholder: identify it on the robot before the first run.
    PERS tooldata tPen:=[TRUE,[[-44.510,9.900,113.950],[1.0000000,0.0000000,0.0000000,0.0000000]],[1,[0,0,50],[1,0,0,0],0,0,0]];
    ! Poses in the world that the controller's configuration must have. The robot's base:
    !   [[0.000,0.000,0.000],[1.0000000,0.0000000,0.0000000,0.0000000]]
    PERS wobjdata wobjPart:=[FALSE,TRUE,"",[[450.000,-50.000,380.000],[1.0000000,0.0000000,0.0000000,0.0000000]],[[0.000,0.000,0.000],[1.0000000,0.0000000,0.0000000,0.0000000]]];

    CONST speeddata vel20:=[20,180,1000,100];
    CONST speeddata vel22:=[22,180,1000,100];
    CONST speeddata vel26:=[26,180,1000,100];
    CONST speeddata vel33:=[33,180,1000,100];
    CONST speeddata vel40:=[40,180,1000,100];
    CONST speeddata vel41:=[41,180,1000,100];
    CONST speeddata vel42:=[42,180,1000,100];
    CONST speeddata vel43:=[43,180,1000,100];
    CONST speeddata vel44:=[44,180,1000,100];
    CONST speeddata vel45:=[45,180,1000,100];
    CONST speeddata vel200:=[200,180,1000,100];

    VAR triggdata trgOn;
    VAR triggdata trgOff;
    VAR triggdata trgOnStart;
    VAR triggdata trgFlow000;
    VAR triggdata trgFlow051;
    VAR triggdata trgFlow055;
    VAR triggdata trgFlow099;
    VAR triggdata trgFlow100;

    PROC main()
        TPWrite "AskedBead: 1 beads";
        SingArea\Off;
        ConfJ\On;
        ConfL\Off;
        SetDO doExtrude,0;
        SetAO aoDemand,0;
        TriggIO trgOn,0\DOp:=doExtrude,1;
        TriggIO trgOff,0\DOp:=doExtrude,0;
        TriggIO trgOnStart,0\Start\DOp:=doExtrude,1;
        TriggIO trgFlow000,0\AOp:=aoDemand,0.0000;
        TriggIO trgFlow051,0\AOp:=aoDemand,3.0600;
        TriggIO trgFlow055,0\AOp:=aoDemand,3.3000;
        TriggIO trgFlow099,0\AOp:=aoDemand,5.9400;
        TriggIO trgFlow100,0\AOp:=aoDemand,6.0000;
        MoveAbsJ [[30.00000,20.00000,30.00000,90.00000,-80.00000,60.00000],[9E9,9E9,9E9,9E9,9E9,9E9]],vel200,fine,tPen\WObj:=wobjPart;
        Start;
        Bead0001;
        Finish;
        SetDO doExtrude,0;
        SetAO aoDemand,0;
        TPWrite "Finished";
    ENDPROC

    PROC Start()
        ! The planned start as a target: the robot must not move here, if tool and work object are right.
        MoveJ [[-2.311,98.797,-2.950],[0.6040228,0.7333283,0.1695307,0.2620026],[0,1,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel200,fine,tPen\WObj:=wobjPart;
    ENDPROC

    PROC Bead0001()
        ! Bead 0, layer 0: 11.9 mm
        MoveJ [[-1.416,45.895,28.637],[0.5616108,0.5616110,0.4296428,0.4296434],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel200,fine,tPen\WObj:=wobjPart;
        MoveL [[-1.773,44.454,29.261],[0.5520929,0.5520929,0.4418070,0.4418070],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel33,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.083,42.905,30.033],[0.5416803,0.5416803,0.4545134,0.4545134],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel45,trgOn\T2:=trgFlow100,z0,tPen\WObj:=wobjPart;
        MoveL [[-2.385,40.850,31.029],[0.5275481,0.5275481,0.4708428,0.4708428],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel44,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.527,39.256,31.618],[0.5163179,0.5163179,0.4831313,0.4831313],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel43,trgFlow099,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.588,37.984,31.909],[0.5071831,0.5071831,0.4927122,0.4927122],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel41,trgFlow055,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.602,37.017,32.003],[0.5001240,0.5001240,0.4998760,0.4998760],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel22,trgFlow051,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.591,36.120,31.986],[0.4934847,0.4934847,0.5064315,0.5064315],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel20,trgFlow099,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.535,34.854,31.796],[0.4839679,0.4839679,0.5155338,0.5155338],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel40,trgFlow100,z0,tPen\WObj:=wobjPart;
        MoveL [[-2.414,33.419,31.363],[0.4729391,0.4729391,0.5256697,0.5256697],[0,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel42,z0,tPen\WObj:=wobjPart;
        MoveL [[-2.277,32.309,30.901],[0.4642259,0.4642259,0.5333801,0.5333801],[0,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel43,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.075,31.046,30.290],[0.4541148,0.4541148,0.5420145,0.5420145],[-1,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel44,trgOff\T2:=trgFlow000,z0,tPen\WObj:=wobjPart;
        MoveL [[-1.645,28.998,29.262],[0.4372165,0.4372165,0.5557353,0.5557353],[-1,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel45,z0,tPen\WObj:=wobjPart;
        MoveL [[-1.411,28.104,28.861],[0.4296523,0.4296472,0.5615988,0.5616128],[-1,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel26,z0,tPen\WObj:=wobjPart;
    ENDPROC

    PROC Finish()
        MoveJ [[-2.311,98.797,-2.950],[0.6040228,0.7333283,0.1695307,0.2620026],[0,1,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel200,fine,tPen\WObj:=wobjPart;
    ENDPROC

ENDMODULE
