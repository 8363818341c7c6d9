MODULE AskedBead
    ! Problem asked_bead, strategy ladder
    ! numpy 2.4, planner 1.0
    ! 1 beads in 1 layers, 12.0 mm deposited, 1.8 s
    ! Verified before it was written:
    !   position_error: 0.0021 mm (limit 0.05)
    !   reach: 0 mm (limit 0)

    ! The load below is a placeholder: identify it on the robot before the first run.
    PERS tooldata tPen:=[TRUE,[[-44.510,9.900,113.950],[1.0000000,0.0000000,0.0000000,0.0000000]],[1,[0,0,50],[1,0,0,0],0,0,0]];
    ! Poses in the world that the controller's configuration must have. The robot's base:
    !   [[0.000,0.000,0.000],[1.0000000,0.0000000,0.0000000,0.0000000]]
    PERS wobjdata wobjPart:=[FALSE,TRUE,"",[[450.000,-50.000,380.000],[1.0000000,0.0000000,0.0000000,0.0000000]],[[0.000,0.000,0.000],[1.0000000,0.0000000,0.0000000,0.0000000]]];

    CONST speeddata vel20:=[20,180,1000,100];
    CONST speeddata vel21:=[21,180,1000,100];
    CONST speeddata vel22:=[22,180,1000,100];
    CONST speeddata vel34:=[34,180,1000,100];
    CONST speeddata vel35:=[35,180,1000,100];
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
    VAR triggdata trgFlow049;
    VAR triggdata trgFlow053;
    VAR triggdata trgFlow098;
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
        TriggIO trgFlow049,0\AOp:=aoDemand,2.9400;
        TriggIO trgFlow053,0\AOp:=aoDemand,3.1800;
        TriggIO trgFlow098,0\AOp:=aoDemand,5.8800;
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
        MoveL [[-1.589,45.230,28.907],[0.5572373,0.5572373,0.4353006,0.4353006],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel22,z0,tPen\WObj:=wobjPart;
        MoveL [[-1.799,44.336,29.317],[0.5513056,0.5513056,0.4427891,0.4427891],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel34,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.083,42.905,30.033],[0.5416803,0.5416803,0.4545134,0.4545134],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel45,trgOn\T2:=trgFlow100,z0,tPen\WObj:=wobjPart;
        MoveL [[-2.324,41.323,30.809],[0.5308369,0.5308369,0.4671318,0.4671318],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel44,z0,tPen\WObj:=wobjPart;
        MoveL [[-2.416,40.529,31.156],[0.5253046,0.5253046,0.4733445,0.4733445],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel44,z0,tPen\WObj:=wobjPart;
        MoveL [[-2.503,39.572,31.511],[0.5185700,0.5185700,0.4807132,0.4807132],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel43,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.554,38.774,31.741],[0.5128789,0.5128789,0.4867805,0.4867805],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel42,trgFlow098,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.590,37.834,31.922],[0.5060967,0.5060967,0.4938281,0.4938281],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel40,trgFlow049,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.600,36.968,31.996],[0.4997678,0.4997678,0.5002321,0.5002321],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel20,trgFlow053,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.589,36.120,31.978],[0.4934896,0.4934896,0.5064267,0.5064267],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel21,trgFlow098,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.559,35.336,31.882],[0.4876092,0.4876092,0.5120911,0.5120911],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel40,trgFlow100,z0,tPen\WObj:=wobjPart;
        MoveL [[-2.499,34.378,31.667],[0.4803316,0.4803316,0.5189235,0.5189235],[0,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel41,z0,tPen\WObj:=wobjPart;
        MoveL [[-2.428,33.581,31.414],[0.4741935,0.4741935,0.5245384,0.5245384],[0,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel42,z0,tPen\WObj:=wobjPart;
        MoveL [[-2.338,32.786,31.105],[0.4679898,0.4679898,0.5300807,0.5300807],[0,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel43,z0,tPen\WObj:=wobjPart;
        MoveL [[-2.229,31.993,30.752],[0.4617213,0.4617213,0.5355497,0.5355497],[-1,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel44,z0,tPen\WObj:=wobjPart;
        TriggL [[-2.075,31.046,30.290],[0.4541148,0.4541148,0.5420145,0.5420145],[-1,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel44,trgOff\T2:=trgFlow000,z0,tPen\WObj:=wobjPart;
        MoveL [[-1.818,29.748,29.631],[0.4434855,0.4434855,0.5507455,0.5507455],[-1,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel45,z0,tPen\WObj:=wobjPart;
        MoveL [[-1.583,28.746,29.143],[0.4350956,0.4350956,0.5573974,0.5573974],[-1,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel35,z0,tPen\WObj:=wobjPart;
        MoveL [[-1.411,28.104,28.861],[0.4296523,0.4296472,0.5615988,0.5616128],[-1,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel22,z0,tPen\WObj:=wobjPart;
    ENDPROC

    PROC Finish()
        MoveJ [[-2.311,98.797,-2.950],[0.6040228,0.7333283,0.1695307,0.2620026],[0,1,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel200,fine,tPen\WObj:=wobjPart;
    ENDPROC

ENDMODULE
