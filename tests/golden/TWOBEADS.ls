/PROG  TWOBEADS
/ATTR
COMMENT		= "beadwise print";
LINE_COUNT	= 72;
DEFAULT_GROUP	= 1,*,*,*,*;
/MN
   1:  !Problem two_beads, strategy ;
   2:  !ladder ;
   3:  !numpy 2.4, planner 1.0 ;
   4:  !1 beads in 1 layers, 10.0 mm ;
   5:  !deposited, 1.8 s ;
   6:  !Verified before it was written: ;
   7:  !  position_error: 0.0021 mm ;
   8:  !(limit 0.05) ;
   9:  !  reach: 0 mm (limit 0) ;
  10:  !Output 1: doExtrude ;
  11:  !J1 to J6, as FANUC counts: ;
  12:  !joint_1, joint_2, joint_3, ;
  13:  !joint_4, joint_5, joint_6 ;
  14:  !Sets UFRAME, UTOOL and PR 9 ;
  15:  !Payload: set it before ;
  16:  PR[9,1]=44.510 ;
  17:  PR[9,2]=(-9.900) ;
  18:  PR[9,3]=113.950 ;
  19:  PR[9,4]=0.000 ;
  20:  PR[9,5]=0.000 ;
  21:  PR[9,6]=180.000 ;
  22:  UTOOL[9]=PR[9] ;
  23:  UTOOL_NUM=9 ;
  24:  PR[9,1]=450.000 ;
  25:  PR[9,2]=(-50.000) ;
  26:  PR[9,3]=(-20.000) ;
  27:  PR[9,4]=0.000 ;
  28:  PR[9,5]=0.000 ;
  29:  PR[9,6]=0.000 ;
  30:  UFRAME[9]=PR[9] ;
  31:  UFRAME_NUM=9 ;
  32:  DO[1]=OFF ;
  33:J P[1] 49% FINE ;
  34:  !Bead 0, layer 0: 9.8 mm ;
  35:J P[2] 49% CNT100 ;
  36:J P[3] 49% CNT100 ;
  37:J P[4] 49% CNT100 ;
  38:J P[5] 49% CNT100 ;
  39:J P[6] 49% CNT100 ;
  40:J P[7] 49% CNT100 ;
  41:J P[8] 49% CNT100 ;
  42:J P[9] 49% CNT100 ;
  43:J P[10] 49% CNT100 ;
  44:J P[11] 49% CNT100 ;
  45:J P[12] 49% CNT100 ;
  46:J P[13] 49% CNT100 ;
  47:J P[14] 49% CNT100 ;
  48:J P[15] 49% CNT100 ;
  49:J P[16] 49% CNT100 ;
  50:J P[17] 49% FINE ;
  51:L P[18] 268cm/min CNT100 DB    0.0mm,DO[1]=ON ;
  52:C P[19]    
    :  P[20] 240cm/min CNT100 ;
  53:L P[21] 123cm/min CNT100 ;
  54:C P[22]    
    :  P[23] 240cm/min CNT100 DB    0.0mm,DO[1]=OFF ;
  55:L P[24] 259cm/min FINE ;
  56:J P[25] 90% CNT100 ;
  57:J P[26] 90% CNT100 ;
  58:J P[27] 90% CNT100 ;
  59:J P[28] 90% CNT100 ;
  60:J P[29] 90% CNT100 ;
  61:J P[30] 90% CNT100 ;
  62:J P[31] 90% CNT100 ;
  63:J P[32] 90% CNT100 ;
  64:J P[33] 90% CNT100 ;
  65:J P[34] 90% CNT100 ;
  66:J P[35] 90% CNT100 ;
  67:J P[36] 90% CNT100 ;
  68:J P[37] 90% CNT100 ;
  69:J P[38] 90% CNT100 ;
  70:J P[39] 90% CNT100 ;
  71:J P[40] 90% FINE ;
  72:  DO[1]=OFF ;
/POS
P[1]{
   GP1:
	UF : 9, UT : 9,	
	J1=    30.000 deg,	J2=    20.000 deg,	J3=   -50.000 deg,
	J4=   -90.000 deg,	J5=    80.000 deg,	J6=   -60.000 deg
};
P[2]{
   GP1:
	UF : 9, UT : 9,	
	J1=    29.493 deg,	J2=    20.015 deg,	J3=   -51.233 deg,
	J4=   -87.660 deg,	J5=    80.233 deg,	J6=   -61.088 deg
};
P[3]{
   GP1:
	UF : 9, UT : 9,	
	J1=    28.967 deg,	J2=    19.752 deg,	J3=   -52.233 deg,
	J4=   -85.232 deg,	J5=    80.475 deg,	J6=   -62.218 deg
};
P[4]{
   GP1:
	UF : 9, UT : 9,	
	J1=    28.233 deg,	J2=    19.055 deg,	J3=   -53.300 deg,
	J4=   -81.842 deg,	J5=    80.812 deg,	J6=   -63.795 deg
};
P[5]{
   GP1:
	UF : 9, UT : 9,	
	J1=    26.218 deg,	J2=    16.543 deg,	J3=   -55.630 deg,
	J4=   -72.536 deg,	J5=    81.739 deg,	J6=   -68.123 deg
};
P[6]{
   GP1:
	UF : 9, UT : 9,	
	J1=    25.475 deg,	J2=    15.818 deg,	J3=   -56.690 deg,
	J4=   -69.106 deg,	J5=    82.080 deg,	J6=   -69.718 deg
};
P[7]{
   GP1:
	UF : 9, UT : 9,	
	J1=    24.856 deg,	J2=    15.417 deg,	J3=   -57.776 deg,
	J4=   -66.248 deg,	J5=    82.365 deg,	J6=   -71.048 deg
};
P[8]{
   GP1:
	UF : 9, UT : 9,	
	J1=    24.222 deg,	J2=    15.239 deg,	J3=   -59.120 deg,
	J4=   -63.324 deg,	J5=    82.656 deg,	J6=   -72.408 deg
};
P[9]{
   GP1:
	UF : 9, UT : 9,	
	J1=    23.582 deg,	J2=    15.322 deg,	J3=   -60.742 deg,
	J4=   -60.366 deg,	J5=    82.951 deg,	J6=   -73.783 deg
};
P[10]{
   GP1:
	UF : 9, UT : 9,	
	J1=    22.941 deg,	J2=    15.678 deg,	J3=   -62.637 deg,
	J4=   -57.408 deg,	J5=    83.245 deg,	J6=   -75.159 deg
};
P[11]{
   GP1:
	UF : 9, UT : 9,	
	J1=    22.308 deg,	J2=    16.289 deg,	J3=   -64.770 deg,
	J4=   -54.484 deg,	J5=    83.536 deg,	J6=   -76.519 deg
};
P[12]{
   GP1:
	UF : 9, UT : 9,	
	J1=    21.537 deg,	J2=    17.347 deg,	J3=   -67.678 deg,
	J4=   -50.926 deg,	J5=    83.891 deg,	J6=   -78.174 deg
};
P[13]{
   GP1:
	UF : 9, UT : 9,	
	J1=    20.522 deg,	J2=    19.141 deg,	J3=   -71.913 deg,
	J4=   -46.237 deg,	J5=    84.358 deg,	J6=   -80.355 deg
};
P[14]{
   GP1:
	UF : 9, UT : 9,	
	J1=    18.828 deg,	J2=    22.425 deg,	J3=   -79.266 deg,
	J4=   -38.416 deg,	J5=    85.136 deg,	J6=   -83.993 deg
};
P[15]{
   GP1:
	UF : 9, UT : 9,	
	J1=    18.119 deg,	J2=    23.546 deg,	J3=   -82.090 deg,
	J4=   -35.144 deg,	J5=    85.462 deg,	J6=   -85.515 deg
};
P[16]{
   GP1:
	UF : 9, UT : 9,	
	J1=    17.527 deg,	J2=    24.188 deg,	J3=   -84.156 deg,
	J4=   -32.408 deg,	J5=    85.735 deg,	J6=   -86.788 deg
};
P[17]{
   GP1:
	UF : 9, UT : 9,	
	J1=    17.164 deg,	J2=    24.395 deg,	J3=   -85.235 deg,
	J4=   -30.732 deg,	J5=    85.901 deg,	J6=   -87.567 deg
};
P[18]{
   GP1:
	UF : 9, UT : 9,		CONFIG : 'F U T, 0, 0, 0',
	X =    -2.242  mm,	Y =    41.918  mm,	Z =    30.033  mm,
	W =    90.000 deg,	P =     0.000 deg,	R =    81.684 deg
};
P[19]{
   GP1:
	UF : 9, UT : 9,		CONFIG : 'F U T, 0, 0, 0',
	X =    -2.481  mm,	Y =    39.847  mm,	Z =    31.024  mm,
	W =    90.000 deg,	P =     0.000 deg,	R =    85.282 deg
};
P[20]{
   GP1:
	UF : 9, UT : 9,		CONFIG : 'F U T, 0, 0, 0',
	X =    -2.594  mm,	Y =    37.664  mm,	Z =    31.768  mm,
	W =    90.000 deg,	P =     0.000 deg,	R =    88.880 deg
};
P[21]{
   GP1:
	UF : 9, UT : 9,		CONFIG : 'F U T, 0, 0, 0',
	X =    -2.594  mm,	Y =    36.359  mm,	Z =    31.974  mm,
	W =    90.000 deg,	P =     0.000 deg,	R =    91.080 deg
};
P[22]{
   GP1:
	UF : 9, UT : 9,		CONFIG : 'F U T, 0, 0, 0',
	X =    -2.483  mm,	Y =    34.187  mm,	Z =    31.855  mm,
	W =    90.000 deg,	P =     0.000 deg,	R =    94.673 deg
};
P[23]{
   GP1:
	UF : 9, UT : 9,		CONFIG : 'F U T, 0, 0, 0',
	X =    -2.247  mm,	Y =    32.112  mm,	Z =    31.235  mm,
	W =    90.000 deg,	P =     0.000 deg,	R =    98.266 deg
};
P[24]{
   GP1:
	UF : 9, UT : 9,		CONFIG : 'F U T, 0, 0, 0',
	X =    -1.663  mm,	Y =    29.074  mm,	Z =    29.784  mm,
	W =    90.000 deg,	P =     0.000 deg,	R =   103.481 deg
};
P[25]{
   GP1:
	UF : 9, UT : 9,	
	J1=    -3.847 deg,	J2=    22.770 deg,	J3=   -86.653 deg,
	J4=    14.434 deg,	J5=    88.081 deg,	J6=   -89.332 deg
};
P[26]{
   GP1:
	UF : 9, UT : 9,	
	J1=    -2.182 deg,	J2=    22.094 deg,	J3=   -84.311 deg,
	J4=     9.297 deg,	J5=    87.683 deg,	J6=   -87.890 deg
};
P[27]{
   GP1:
	UF : 9, UT : 9,	
	J1=    -0.097 deg,	J2=    20.895 deg,	J3=   -81.025 deg,
	J4=     2.864 deg,	J5=    87.186 deg,	J6=   -86.083 deg
};
P[28]{
   GP1:
	UF : 9, UT : 9,	
	J1=     5.146 deg,	J2=    17.398 deg,	J3=   -72.279 deg,
	J4=   -13.312 deg,	J5=    85.934 deg,	J6=   -81.539 deg
};
P[29]{
   GP1:
	UF : 9, UT : 9,	
	J1=     7.185 deg,	J2=    16.242 deg,	J3=   -69.082 deg,
	J4=   -19.604 deg,	J5=    85.447 deg,	J6=   -79.772 deg
};
P[30]{
   GP1:
	UF : 9, UT : 9,	
	J1=     8.884 deg,	J2=    15.482 deg,	J3=   -66.621 deg,
	J4=   -24.846 deg,	J5=    85.041 deg,	J6=   -78.300 deg
};
P[31]{
   GP1:
	UF : 9, UT : 9,	
	J1=    10.623 deg,	J2=    14.937 deg,	J3=   -64.336 deg,
	J4=   -30.211 deg,	J5=    84.626 deg,	J6=   -76.793 deg
};
P[32]{
   GP1:
	UF : 9, UT : 9,	
	J1=    12.381 deg,	J2=    14.649 deg,	J3=   -62.287 deg,
	J4=   -35.637 deg,	J5=    84.207 deg,	J6=   -75.269 deg
};
P[33]{
   GP1:
	UF : 9, UT : 9,	
	J1=    14.140 deg,	J2=    14.633 deg,	J3=   -60.510 deg,
	J4=   -41.063 deg,	J5=    83.787 deg,	J6=   -73.745 deg
};
P[34]{
   GP1:
	UF : 9, UT : 9,	
	J1=    15.878 deg,	J2=    14.877 deg,	J3=   -59.014 deg,
	J4=   -46.427 deg,	J5=    83.372 deg,	J6=   -72.238 deg
};
P[35]{
   GP1:
	UF : 9, UT : 9,	
	J1=    17.577 deg,	J2=    15.343 deg,	J3=   -57.779 deg,
	J4=   -51.670 deg,	J5=    82.966 deg,	J6=   -70.766 deg
};
P[36]{
   GP1:
	UF : 9, UT : 9,	
	J1=    19.617 deg,	J2=    16.146 deg,	J3=   -56.541 deg,
	J4=   -57.962 deg,	J5=    82.479 deg,	J6=   -68.998 deg
};
P[37]{
   GP1:
	UF : 9, UT : 9,	
	J1=    25.432 deg,	J2=    18.995 deg,	J3=   -53.568 deg,
	J4=   -75.905 deg,	J5=    81.091 deg,	J6=   -63.959 deg
};
P[38]{
   GP1:
	UF : 9, UT : 9,	
	J1=    27.377 deg,	J2=    19.705 deg,	J3=   -52.330 deg,
	J4=   -81.907 deg,	J5=    80.626 deg,	J6=   -62.273 deg
};
P[39]{
   GP1:
	UF : 9, UT : 9,	
	J1=    28.881 deg,	J2=    19.993 deg,	J3=   -51.113 deg,
	J4=   -86.547 deg,	J5=    80.267 deg,	J6=   -60.970 deg
};
P[40]{
   GP1:
	UF : 9, UT : 9,	
	J1=    30.000 deg,	J2=    20.000 deg,	J3=   -50.000 deg,
	J4=   -90.000 deg,	J5=    80.000 deg,	J6=   -60.000 deg
};
/END
