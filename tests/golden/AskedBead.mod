MODULE AskedBead
    ! Problem asked_bead, strategy ladder
    ! numpy 2.4, planner 1.0
    ! 1 beads in 1 layers, 12.0 mm deposited, 1.8 s
    ! Verified before it was written:
    !   position_error: 0.0021 mm (limit 0.05)
    !   reach: 0 mm (limit 0)
    ! 10 moves, 5 of them along beads, whose toolpath has 12 waypoints
    ! Note: 2 moves on beads are slowed by accelerations of the joints, the worst to 91 % of its speed
    !   first bead 0, line 68 of AskedBead.mod

    ! The load below is a placeholder: identify it on the robot before the first run.
    PERS tooldata tPen:=[TRUE,[[-44.510,9.900,113.950],[1.0000000,0.0000000,0.0000000,0.0000000]],[1,[0,0,50],[1,0,0,0],0,0,0]];
    ! Poses in the world that the controller's configuration must have. The robot's base:
    !   [[0.000,0.000,0.000],[1.0000000,0.0000000,0.0000000,0.0000000]]
    PERS wobjdata wobjPart:=[FALSE,TRUE,"",[[450.000,-50.000,380.000],[1.0000000,0.0000000,0.0000000,0.0000000]],[[0.000,0.000,0.000],[1.0000000,0.0000000,0.0000000,0.0000000]]];

    CONST speeddata vel19_4:=[19.4,180,1000,100];
    CONST speeddata vel40:=[40,180,1000,100];
    CONST speeddata vel45:=[45,180,1000,100];
    CONST speeddata vel200:=[200,180,1000,100];
    CONST zonedata zon0_1:=[FALSE,0.1,0.1,0.1,0.01,0.1,0.01];

    VAR triggdata trgOn;
    VAR triggdata trgOff;
    VAR triggdata trgOnStart;
    VAR triggdata trgFlow000;
    VAR triggdata trgFlow044;
    VAR triggdata trgFlow095;
    VAR triggdata trgFlow099;
    VAR triggdata trgFlow100;

    PROC main()
        TPWrite "AskedBead: 1 beads";
        SingArea\Off;
        ConfJ\On;
        ConfL\Off;
        CirPathMode\ObjectFrame;
        SetDO doExtrude,0;
        SetAO aoDemand,0;
        TriggIO trgOn,0\DOp:=doExtrude,1;
        TriggIO trgOff,0\DOp:=doExtrude,0;
        TriggIO trgOnStart,0\Start\DOp:=doExtrude,1;
        TriggIO trgFlow000,0\AOp:=aoDemand,0.0000;
        TriggIO trgFlow044,0\AOp:=aoDemand,2.6400;
        TriggIO trgFlow095,0\AOp:=aoDemand,5.7000;
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
        TriggL [[-2.083,42.905,30.033],[0.5416803,0.5416803,0.4545134,0.4545134],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel45,trgOn\T2:=trgFlow100,z5,tPen\WObj:=wobjPart;
        TriggL [[-2.448,40.210,31.283],[0.5230713,0.5230713,0.4758113,0.4758113],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel40,trgFlow095,z5,tPen\WObj:=wobjPart;
        TriggC [[-2.549,38.863,31.718],[0.5133500,0.5133500,0.4862837,0.4862837],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],[[-2.597,37.467,31.965],[0.5034190,0.5034190,0.4965575,0.4965575],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel40,trgFlow044,z1,tPen\WObj:=wobjPart;
        TriggL [[-2.592,36.262,31.987],[0.4945425,0.4945425,0.5053986,0.5053986],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel19_4,trgFlow099,z1,tPen\WObj:=wobjPart;
        TriggC [[-2.535,34.899,31.796],[0.4844625,0.4844625,0.5150690,0.5150690],[0,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],[[-2.428,33.581,31.414],[0.4741935,0.4741935,0.5245384,0.5245384],[0,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel40,trgFlow100,z5,tPen\WObj:=wobjPart;
        TriggL [[-2.075,31.046,30.290],[0.4541148,0.4541148,0.5420145,0.5420145],[-1,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel40,trgOff\T2:=trgFlow000,z5,tPen\WObj:=wobjPart;
        MoveL [[-1.411,28.104,28.861],[0.4296523,0.4296472,0.5615988,0.5616128],[-1,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel45,zon0_1,tPen\WObj:=wobjPart;
    ENDPROC

    PROC Finish()
        MoveJ [[-2.311,98.797,-2.950],[0.6040228,0.7333283,0.1695307,0.2620026],[0,1,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel200,fine,tPen\WObj:=wobjPart;
    ENDPROC

ENDMODULE
